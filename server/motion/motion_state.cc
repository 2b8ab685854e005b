// SPDX-License-Identifier: Apache-2.0
// What the models of motion know as plain data.
#include "map_store/geometry/state_fields.h"
#include "server/motion/interacting_models.h"

namespace groundlock::motion {

struct StateFields {
  template <typename Stream, base::StateOf<InteractingModels> T>
  static void Of(Stream& stream, T& models) {
    Field(stream, "motion.size", models.options_.target_size_m);
    if (!(models.options_.target_size_m > 0.0)) stream.Fail("is not positive");
    Field(stream, "motion.time", models.time_);
    for (auto& model : models.models_) {
      Field(stream, "motion.state", model.x);
      Covariance(stream, "motion.covariance", model.covariance);
      Field(stream, "motion.probability", model.probability);
      // None ever becomes impossible.
      if (!(model.probability > 0.0 && model.probability <= 1.0 + 1e-9)) {
        stream.Fail("is none");
      }
    }
  }
};

void InteractingModels::SaveState(base::StateWriter& writer) const {
  StateFields::Of(writer, *this);
}

void InteractingModels::RestoreState(base::StateReader& reader) {
  StateFields::Of(reader, *this);
}

}  // namespace groundlock::motion
