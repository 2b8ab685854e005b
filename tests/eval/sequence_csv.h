// SPDX-License-Identifier: Apache-2.0
// Results in the columns of the results CSV.
#ifndef GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_
#define GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_

#include <ostream>

#include "server/tracking/tracking_session.h"

namespace groundlock::eval {

void WriteResultsHeader(std::ostream& out);
// One row per target of the result (one without a target if there is none).
void WriteResults(std::ostream& out, const tracking::FrameResult& result);
// The movers, in the columns of client/cli/movers_csv.h.
void WriteMoversHeader(std::ostream& out);
void WriteMovers(std::ostream& out, const tracking::FrameResult& result);

}  // namespace groundlock::eval

#endif  // GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_
