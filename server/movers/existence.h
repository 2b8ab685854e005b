// SPDX-License-Identifier: Apache-2.0
// Whether something exists that is seen now and then: integrated probabilistic
// data association.
// Source: Musicki, Evans & Stankovic 1994, "Integrated probabilistic data
// association", IEEE Trans. Automatic Control 39(6), Markov chain one.
#ifndef GROUNDLOCK_SERVER_MOVERS_EXISTENCE_H_
#define GROUNDLOCK_SERVER_MOVERS_EXISTENCE_H_

namespace groundlock::movers {

// Chosen on the rendered sequences of the lot (docs/benchmarks.md).
struct ExistenceModel {
  // A thing that exists is found in a key view.
  double detection = 0.85;
  // It goes on moving for so long, in the mean.
  double lifetime_s = 8.0;
  // Of what is found for the first time, so much exists.
  double birth = 0.15;
  // What is found again is so much likelier to be there than chance: chance
  // comes back, too, since both are of the same followed points.
  double max_likelihood_ratio = 4.0;
};

double PredictExistence(const ExistenceModel& model,
                        double existence,
                        double step_s);
// It was looked for and not found.
double NotFound(const ExistenceModel& model, double existence);
// It was found.
//   likelihood_ratio  density of where it was found, were it there, over that
//                     of chance findings.
double Found(const ExistenceModel& model,
             double existence,
             double likelihood_ratio);

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_EXISTENCE_H_
