// SPDX-License-Identifier: Apache-2.0
#include "client/sdk/channel.h"

#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/client_interceptor.h>

#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

using grpc::experimental::InterceptionHookPoints;

// Adds the token to what a call begins with. gRPC's own credentials would want
// TLS, which a server on the loopback goes without.
class TokenInterceptor final : public grpc::experimental::Interceptor {
 public:
  explicit TokenInterceptor(const std::string& value) : value_(value) {}
  void Intercept(grpc::experimental::InterceptorBatchMethods* call) override {
    if (call->QueryInterceptionHookPoint(
            InterceptionHookPoints::PRE_SEND_INITIAL_METADATA)) {
      call->GetSendInitialMetadata()->emplace("authorization", value_);
    }
    call->Proceed();
  }

 private:
  const std::string& value_;
};

class TokenInterceptorFactory final
    : public grpc::experimental::ClientInterceptorFactoryInterface {
 public:
  explicit TokenInterceptorFactory(const std::string& token)
      : value_(absl::StrCat("Bearer ", token)) {}
  grpc::experimental::Interceptor* CreateClientInterceptor(
      grpc::experimental::ClientRpcInfo* /*info*/) override {
    return new TokenInterceptor(value_);  // gRPC takes it over
  }

 private:
  const std::string value_;
};

absl::StatusOr<std::string> ReadPem(const std::filesystem::path& path) {
  constexpr std::uint64_t kMaxBytes = 1 << 20;
  ASSIGN_OR_RETURN(std::string text, base::ReadFile(path, kMaxBytes));
  if (!absl::StrContains(text, "-----BEGIN ")) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": not in PEM form"));
  }
  return text;
}

absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> MakeCredentials(
    const ClientTls& tls) {
  // Where Debian keeps what it believes in; gRPC's own list would be older.
  constexpr char kSystemCa[] = "/etc/ssl/certs/ca-certificates.crt";
  grpc::SslCredentialsOptions options;
  if (!tls.ca.empty()) {
    ASSIGN_OR_RETURN(options.pem_root_certs, ReadPem(tls.ca));
  } else if (auto text = ReadPem(kSystemCa); text.ok()) {
    options.pem_root_certs = *std::move(text);
  }
  if (!tls.certificate.empty()) {
    ASSIGN_OR_RETURN(options.pem_cert_chain, ReadPem(tls.certificate));
    ASSIGN_OR_RETURN(options.pem_private_key, ReadPem(tls.key));
  }
  return grpc::SslCredentials(options);
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(
    const std::string& target_or_url, const ClientOptions& options) {
  std::string_view target = target_or_url;
  ClientTls tls = options.tls;
  for (const auto& [scheme, secure] :
       {std::pair("grpc://", false), {"grpcs://", true}}) {
    if (!target.starts_with(scheme)) continue;
    target.remove_prefix(std::string_view(scheme).size());
    tls.enabled = tls.enabled || secure;
    break;
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials =
      grpc::InsecureChannelCredentials();
  if (tls.enabled) {
    ASSIGN_OR_RETURN(credentials, MakeCredentials(tls));
  }
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(options.max_message_bytes);
  arguments.SetMaxSendMessageSize(-1);  // the server knows its own limit
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  // Streams reconnect by themselves and sooner than gRPC's default allows.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 1'000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 5'000);
  // Clients in one process do not share a connection behind our back.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  if (!tls.server_name.empty()) {
    arguments.SetSslTargetNameOverride(tls.server_name);
  }
  if (options.token.empty()) {
    return grpc::CreateCustomChannel(
        std::string(target), credentials, arguments);
  }
  std::vector<
      std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>>
      interceptors;
  interceptors.push_back(
      std::make_unique<TokenInterceptorFactory>(options.token));
  return grpc::experimental::CreateCustomChannelWithInterceptors(
      std::string(target), credentials, arguments, std::move(interceptors));
}

}  // namespace groundlock::sdk
