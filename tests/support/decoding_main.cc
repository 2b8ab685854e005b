// SPDX-License-Identifier: Apache-2.0
// main() of tests in which strangers' media are decoded: their decoders are the
// test's own program. Link it before GoogleTest's.
#include <gtest/gtest.h>

#include "map_store/decoding/decoder.h"

int main(int argc, char** argv) {
  if (const auto status = groundlock::decoding::RunDecoderIfAsked(argc, argv)) {
    return *status;
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
