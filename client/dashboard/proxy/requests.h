// SPDX-License-Identifier: Apache-2.0
// What is done about a viewer's requests.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUESTS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUESTS_H_

#include <memory>

#include "client/dashboard/proxy/core.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

class Viewer;

// Replies through the viewer, at once or later; does not wait. On the viewer's
// strand. request: as ParseRequest returns it.
void HandleRequest(Core& core,
                   const std::shared_ptr<Viewer>& viewer,
                   pb::ClientMessage request);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUESTS_H_
