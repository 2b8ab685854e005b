// SPDX-License-Identifier: Apache-2.0
// Precompiled for the rooms that speak gRPC.
#include "cmake/pch/base.h"

#include <google/protobuf/message.h>
#include <grpcpp/grpcpp.h>
