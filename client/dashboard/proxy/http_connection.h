// SPDX-License-Identifier: Apache-2.0
// One HTTP connection, until it closes or becomes a viewer's WebSocket.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_CONNECTION_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_CONNECTION_H_

#include <chrono>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/address_places.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/core.h"
#include "client/dashboard/proxy/http_rules.h"

namespace groundlock::dashboard {

// Answers one request after the other. Runs on its own strand; what reads or
// writes files runs on the core's work pool meanwhile.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  // network: where it comes from. place: held until the connection is closed.
  HttpConnection(Core* core,
                 Tcp::socket&& socket,
                 std::string network,
                 AddressPlaces::Place place);
  ~HttpConnection();
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;
  void Run();

 private:
  using Header = http::request<http::empty_body>;
  using Response = http::response<http::string_body>;

  void ReadHeader();
  void OnHeader(error_code error);
  void Route();
  void RouteApi();
  // Whether a page may do this; answers if not.
  bool CheckCaller(bool changes_something);
  // Who calls; answers and returns nullopt if they must log in first.
  std::optional<Login> Authorize();
  std::optional<Login> CookieLogin() const;
  // What is wrong with the caller's rights, if that is so, has been answered.
  bool Refused(const absl::Status& right);

  void ReadBody(std::function<void(std::string)> use);
  void Info();
  void LogIn(const std::string& body);
  void FinishLogin(const std::string& token,
                   const absl::StatusOr<gl::GetCallerResponse>& caller);
  void EndLogin();
  void LogOut();
  void CreateUpload(const std::string& body, const std::string& owner);
  void RemoveUpload(const std::string& id);
  void ServeStatic();
  void ServeRecording(const std::string& name);
  void ServeRecordedTrajectory(const std::string& name);
  void ServeTrajectory(const Login& login, const std::string& session_id);
  void AnswerTrajectory(
      const std::vector<std::shared_ptr<const gl::FrameResult>>& results,
      const std::optional<gl::GeodeticPosition>& origin,
      const std::string& name);

  void StartUpload(const std::string& id);
  void ReadUpload();
  void OnUploadData(error_code error);
  void AnswerUpload(const absl::Status& status);
  void SendFilePart();

  Response MakeResponse(http::status status) const;
  void Answer(Response response);
  void AnswerJson(http::status status, const std::string& text);
  void AnswerError(const absl::Status& status);
  void AnswerError(http::status status, const absl::Status& reason);
  void OnAnswered(bool keep_alive, error_code error);
  void Drain();
  // A client that takes longer over one read or write is let go.
  static constexpr std::chrono::seconds kTimeout{30};
  // Of files, in one go.
  static constexpr std::size_t kBlockBytes = 256 << 10;
  // Runs `work` on the pool, and what it returns on the strand.
  template <typename Work>
  void OnDisk(Work work);

  // A file on its way in, and one on its way out.
  struct Upload {
    explicit Upload(http::request_parser<http::empty_body>&& header)
        : parser(std::move(header)) {}
    http::request_parser<http::buffer_body> parser;
    std::string block;
    std::unique_ptr<UploadFile> file;
  };
  struct Download {
    std::ifstream file;
    std::uint64_t left = 0;
    std::string block;
    bool keep_alive = false;
  };

  Core* const core_;
  const std::string network_;
  const AddressPlaces::Place place_;
  beast::tcp_stream stream_;
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::empty_body>> parser_;
  std::shared_ptr<http::request_parser<http::string_body>> body_parser_;
  Target target_;
  bool body_unread_ = false;  // the connection is of no use after the answer
  std::unique_ptr<asio::steady_timer> delay_;
  AddressPlaces::Place login_place_;  // while it logs in
  std::optional<std::chrono::steady_clock::time_point> drain_end_;

  std::shared_ptr<Upload> upload_;
  std::shared_ptr<Download> download_;
};

template <typename Work>
void HttpConnection::OnDisk(Work work) {
  asio::post(core_->work,
             [self = shared_from_this(), work = std::move(work)]() mutable {
               auto then = work();
               asio::post(self->stream_.get_executor(), std::move(then));
             });
}

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_HTTP_CONNECTION_H_
