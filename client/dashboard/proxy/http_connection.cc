// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/http_connection.h"

#include <chrono>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/rights.h"
#include "client/dashboard/proxy/viewer.h"
#include "map_store/base/status.h"
#include "map_store/base/version.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

using nlohmann::json;

constexpr std::chrono::seconds kDrainTimeout{5};
// However much a client goes on to send.
constexpr std::chrono::seconds kWholeDrainTimeout{60};
constexpr std::size_t kMaxHeaderBytes = 16 << 10;
constexpr std::size_t kMaxJsonBytes = 64 << 10;
constexpr std::chrono::milliseconds kWrongTokenDelay{500};
constexpr std::string_view kCookie = "groundlock_login";
constexpr std::size_t kMaxTokenBytes = 8'192;  // a JWT may be long

// Scripts, styles and connections of our own only.
constexpr char kContentSecurityPolicy[] =
    "default-src 'self'; img-src 'self' blob: data:; style-src 'self' "
    "'unsafe-inline'; connect-src 'self'; worker-src 'self' blob:; object-src "
    "'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

http::status HttpStatus(absl::StatusCode code) {
  switch (code) {
    case absl::StatusCode::kInvalidArgument:
      return http::status::bad_request;
    case absl::StatusCode::kUnauthenticated:
      return http::status::unauthorized;
    case absl::StatusCode::kPermissionDenied:
      return http::status::forbidden;
    case absl::StatusCode::kNotFound:
      return http::status::not_found;
    case absl::StatusCode::kAlreadyExists:
    case absl::StatusCode::kFailedPrecondition:
      return http::status::conflict;
    case absl::StatusCode::kOutOfRange:
      return http::status::range_not_satisfiable;
    case absl::StatusCode::kResourceExhausted:
      return http::status::payload_too_large;
    case absl::StatusCode::kUnavailable:
      return http::status::service_unavailable;
    default:
      return http::status::internal_server_error;
  }
}

std::string ErrorJson(const absl::Status& status) {
  return json{{"code", absl::StatusCodeToString(status.code())},
              {"message", std::string(status.message())}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace

HttpConnection::HttpConnection(Core* core,
                               Tcp::socket&& socket,
                               std::string network,
                               AddressPlaces::Place place)
    : core_(core),
      network_(std::move(network)),
      place_(std::move(place)),
      stream_(std::move(socket)) {
  ++core_->connections;
}

HttpConnection::~HttpConnection() { --core_->connections; }

void HttpConnection::Run() {
  asio::post(stream_.get_executor(),
             [self = shared_from_this()] { self->ReadHeader(); });
}

void HttpConnection::ReadHeader() {
  parser_.emplace();
  parser_->header_limit(kMaxHeaderBytes);
  // Each call has its own. (Boost 1.74 takes none at all for 0.)
  parser_->body_limit(std::numeric_limits<std::uint64_t>::max());
  body_unread_ = false;
  stream_.expires_after(kTimeout);
  http::async_read_header(
      stream_,
      buffer_,
      *parser_,
      [self = shared_from_this()](error_code error, std::size_t) {
        self->OnHeader(error);
      });
}

void HttpConnection::OnHeader(error_code error) {
  if (error == http::error::header_limit || error == http::error::bad_target ||
      error == http::error::bad_method || error == http::error::bad_version) {
    body_unread_ = true;
    AnswerError(http::status::bad_request,
                absl::InvalidArgumentError("not a request"));
    return;
  }
  if (error) return;  // closed, timed out, or no HTTP
  body_unread_ = !parser_->is_done();
  auto target = ParseTarget(View(parser_->get().target()));
  if (!target.ok()) {
    AnswerError(target.status());
    return;
  }
  target_ = *std::move(target);
  Route();
}

bool HttpConnection::CheckCaller(bool changes_something) {
  const Header& request = parser_->get();
  const std::vector<std::string>& allowed = core_->options.allowed_origins;
  const std::string_view host = View(request[http::field::host]);
  if (!HostAllowed(host, allowed)) {
    AnswerError(
        http::status::misdirected_request,
        absl::PermissionDeniedError("this dashboard is not known by that name: "
                                    "--allow-origin https://NAME permits it"));
    return false;
  }
  if (changes_something &&
      !OriginAllowed(View(request[http::field::origin]), host, allowed)) {
    AnswerError(absl::PermissionDeniedError(
        "pages of other origins may not do this: --allow-origin permits one"));
    return false;
  }
  return true;
}

std::optional<Login> HttpConnection::CookieLogin() const {
  const auto cookie =
      CookieValue(View(parser_->get()[http::field::cookie]), kCookie);
  return cookie.has_value() ? core_->logins.Find(*cookie) : std::nullopt;
}

std::optional<Login> HttpConnection::Authorize() {
  auto login = CookieLogin();
  if (login.has_value()) return login;
  const auto required = core_->catalogue->login_required();
  if (!required.has_value()) {
    AnswerError(absl::UnavailableError(
        "the Groundlock server has not answered yet: is it running?"));
    return std::nullopt;
  }
  if (*required) {
    AnswerError(absl::UnauthenticatedError("log in first"));
    return std::nullopt;
  }
  gl::GetCallerResponse anybody;
  anybody.set_open_to_all(true);
  return Login{std::string(kNobodysToken), std::move(anybody), ""};
}

bool HttpConnection::Refused(const absl::Status& right) {
  if (right.ok()) return false;
  AnswerError(right);
  return true;
}

void HttpConnection::Route() {
  const Header& request = parser_->get();
  const bool reads = request.method() == http::verb::get ||
                     request.method() == http::verb::head;
  const bool upgrade = websocket::is_upgrade(request);
  if (!CheckCaller(!reads || upgrade)) return;
  const std::vector<std::string>& path = target_.path;
  if (upgrade) {
    if (path != std::vector<std::string>{"ws"}) {
      AnswerError(absl::NotFoundError("the WebSocket is at /ws"));
      return;
    }
    const auto login = Authorize();
    if (!login.has_value()) return;
    const auto viewer =
        std::make_shared<Viewer>(core_, std::move(stream_), *login, place_);
    viewer->Run(request);
    return;
  }
  if (path.front() == "api") {
    RouteApi();
    return;
  }
  if (!reads) {
    AnswerError(http::status::method_not_allowed,
                absl::InvalidArgumentError("only GET is understood here"));
    return;
  }
  if (path == std::vector<std::string>{"healthz"}) {
    Response response = MakeResponse(http::status::ok);
    response.set(http::field::content_type, "text/plain");
    response.body() = "ok\n";
    Answer(std::move(response));
    return;
  }
  ServeStatic();
}

void HttpConnection::RouteApi() {
  const std::vector<std::string>& path = target_.path;
  const http::verb method = parser_->get().method();
  const auto is = [&](http::verb verb, std::size_t parts, const char* second) {
    return (method == verb ||
            (method == http::verb::head && verb == http::verb::get)) &&
           path.size() == parts && path[1] == second;
  };
  if (is(http::verb::get, 2, "info")) return Info();
  if (is(http::verb::post, 2, "login")) {
    return ReadBody([this](const std::string& body) { LogIn(body); });
  }
  if (is(http::verb::post, 2, "logout")) return LogOut();
  const auto login = Authorize();
  if (!login.has_value()) return;
  if (path.size() > 1 && path[1] == "uploads" &&
      Refused(MayUpload(login->caller))) {
    return;
  }
  if (is(http::verb::post, 2, "uploads")) {
    return ReadBody(
        [this, owner = login->caller.name()](const std::string& body) {
          CreateUpload(body, owner);
        });
  }
  if (path.size() > 2 && path[1] == "uploads" && core_->uploads != nullptr) {
    const auto upload = core_->uploads->Find(path[2]);
    if (upload.ok() && Refused(MayChangeUpload(login->caller, upload->owner))) {
      return;
    }
  }
  if (method == http::verb::put && path.size() >= 4 && path[1] == "uploads") {
    return StartUpload(path[2]);
  }
  if (is(http::verb::delete_, 3, "uploads")) return RemoveUpload(path[2]);
  if (is(http::verb::get, 3, "recordings")) return ServeRecording(path[2]);
  if (is(http::verb::get, 4, "recordings") && path[3] == "trajectory") {
    return ServeRecordedTrajectory(path[2]);
  }
  if (is(http::verb::get, 4, "sessions") && path[3] == "trajectory") {
    return ServeTrajectory(*login, path[2]);
  }
  AnswerError(absl::NotFoundError("no such call"));
}

void HttpConnection::ReadBody(std::function<void(std::string)> use) {
  // Beast looks at an announced length with the header only.
  if (parser_->content_length().value_or(0) > kMaxJsonBytes) {
    AnswerError(absl::ResourceExhaustedError("the request is too large"));
    return;
  }
  body_parser_ = std::make_shared<http::request_parser<http::string_body>>(
      std::move(*parser_));
  body_parser_->body_limit(kMaxJsonBytes);
  stream_.expires_after(kTimeout);
  http::async_read(
      stream_,
      buffer_,
      *body_parser_,
      [self = shared_from_this(), use = std::move(use)](error_code error,
                                                        std::size_t) {
        if (error && error != http::error::body_limit) return;
        self->body_unread_ = static_cast<bool>(error);
        std::string body = std::move(self->body_parser_->get().body());
        // The header goes back to where everything looks for it.
        self->parser_.emplace();
        self->parser_->get().base() =
            std::move(self->body_parser_->get().base());
        if (error) {
          self->AnswerError(
              absl::ResourceExhaustedError("the request is too large"));
        } else {
          use(std::move(body));
        }
      });
}

void HttpConnection::Info() {
  const auto required = core_->catalogue->login_required();
  const auto state = core_->catalogue->server_state().state();
  json info{{"version", base::Version()},
            {"server_state",
             state == pb::ServerState::STATE_CONNECTED     ? "connected"
             : state == pb::ServerState::STATE_UNREACHABLE ? "unreachable"
                                                           : "unknown"},
            {"login_required", nullptr},
            {"logged_in", CookieLogin().has_value()}};
  if (required.has_value()) info["login_required"] = *required;
  AnswerJson(http::status::ok, info.dump());
}

void HttpConnection::LogIn(const std::string& body) {
  const json request = json::parse(body, nullptr, false);
  if (!request.is_object() || !request.contains("token") ||
      !request["token"].is_string()) {
    AnswerError(absl::InvalidArgumentError("token: expected {\"token\": …}"));
    return;
  }
  const std::string token = request["token"].get<std::string>();
  const bool printable = std::all_of(
      token.begin(), token.end(), [](char c) { return c > ' ' && c < '\x7f'; });
  if (token.empty() || token.size() > kMaxTokenBytes || !printable) {
    AnswerError(absl::UnauthenticatedError("this is no token"));
    return;
  }
  login_place_ = core_->login_places.Take(network_);
  if (login_place_ == nullptr || ++core_->logins_under_way > Core::kMaxLogins) {
    if (login_place_ != nullptr) --core_->logins_under_way;
    login_place_ = nullptr;
    AnswerError(http::status::too_many_requests,
                absl::ResourceExhaustedError("too many log-ins: try again"));
    return;
  }
  core_->relay->Call(
      token,
      gl::GetCallerRequest(),
      [self = shared_from_this(),
       token](const absl::StatusOr<gl::GetCallerResponse>& caller) {
        asio::post(self->stream_.get_executor(),
                   [self, token, caller] { self->FinishLogin(token, caller); });
      });
}

void HttpConnection::FinishLogin(
    const std::string& token,
    const absl::StatusOr<gl::GetCallerResponse>& caller) {
  if (caller.ok()) {
    EndLogin();
    const auto self = core_->catalogue->self();
    if (!self.has_value()) {
      AnswerError(
          absl::UnavailableError(core_->catalogue->server_state().message()));
      return;
    }
    if (Refused(MayLookOn(*caller, *self))) return;
    Response response = MakeResponse(http::status::no_content);
    response.set(http::field::set_cookie,
                 absl::StrCat(base::Abseil(kCookie),
                              "=",
                              core_->logins.Add({token, *caller, ""}),
                              "; Path=/; HttpOnly; SameSite=Strict",
                              core_->options.secure_cookie ? "; Secure" : ""));
    core_->catalogue->Refresh();
    Answer(std::move(response));
    return;
  }
  if (!absl::IsUnauthenticated(caller.status())) {
    EndLogin();
    AnswerError(absl::UnavailableError(absl::StrCat(
        "the Groundlock server does not answer: ", caller.status().message())));
    return;
  }
  // Guessing takes time.
  delay_ = std::make_unique<asio::steady_timer>(stream_.get_executor(),
                                                kWrongTokenDelay);
  delay_->async_wait([self = shared_from_this()](error_code) {
    self->EndLogin();
    self->AnswerError(
        absl::UnauthenticatedError("the server does not know this token"));
  });
}

void HttpConnection::EndLogin() {
  --core_->logins_under_way;
  login_place_ = nullptr;
}

void HttpConnection::LogOut() {
  const auto cookie =
      CookieValue(View(parser_->get()[http::field::cookie]), kCookie);
  if (cookie.has_value()) {
    core_->logins.Remove(*cookie);
    core_->catalogue->DismissLogin(*cookie);
  }
  Response response = MakeResponse(http::status::no_content);
  response.set(http::field::set_cookie,
               absl::StrCat(base::Abseil(kCookie), "=; Path=/; Max-Age=0"));
  Answer(std::move(response));
}

HttpConnection::Response HttpConnection::MakeResponse(
    http::status status) const {
  Response response(status, 11);
  response.set(http::field::server, "groundlock-dashboard");
  response.set("X-Content-Type-Options", "nosniff");
  response.set("Referrer-Policy", "no-referrer");
  response.set("Content-Security-Policy", kContentSecurityPolicy);
  response.set("Cross-Origin-Opener-Policy", "same-origin");
  response.set("Cross-Origin-Resource-Policy", "same-origin");
  return response;
}

void HttpConnection::AnswerJson(http::status status, const std::string& text) {
  Response response = MakeResponse(status);
  response.set(http::field::content_type, "application/json");
  response.set(http::field::cache_control, "no-store");
  response.body() = text;
  Answer(std::move(response));
}

void HttpConnection::AnswerError(const absl::Status& status) {
  AnswerError(HttpStatus(status.code()), status);
}

void HttpConnection::AnswerError(http::status status,
                                 const absl::Status& reason) {
  AnswerJson(status, ErrorJson(reason));
}

void HttpConnection::Answer(Response response) {
  const bool keep_alive = parser_->get().keep_alive() && !body_unread_;
  response.keep_alive(keep_alive);
  const bool head = parser_->get().method() == http::verb::head;
  response.prepare_payload();
  const std::size_t hundreds = response.result_int() / 100;
  if (hundreds < core_->counters.answers.size()) {
    ++core_->counters.answers[hundreds];
  }
  if (head) response.body().clear();  // its length stays
  const auto shared = std::make_shared<Response>(std::move(response));
  stream_.expires_after(kTimeout);
  http::async_write(stream_,
                    *shared,
                    [self = shared_from_this(), shared, keep_alive](
                        error_code error, std::size_t) {
                      self->OnAnswered(keep_alive, error);
                    });
}

void HttpConnection::OnAnswered(bool keep_alive, error_code error) {
  if (error) return;
  if (keep_alive) {
    ReadHeader();
    return;
  }
  error_code ignored;
  stream_.socket().shutdown(Tcp::socket::shutdown_send, ignored);
  if (!body_unread_) return;
  drain_end_ = std::chrono::steady_clock::now() + kWholeDrainTimeout;
  Drain();
}

// Closing with bytes unread would tear the answer away from the other side.
void HttpConnection::Drain() {
  stream_.expires_after(kDrainTimeout);
  buffer_.clear();
  stream_.async_read_some(
      buffer_.prepare(kBlockBytes),
      [self = shared_from_this()](error_code error, std::size_t) {
        const bool is_over =
            std::chrono::steady_clock::now() > *self->drain_end_;
        if (!error && !is_over) self->Drain();
      });
}

}  // namespace groundlock::dashboard
