// SPDX-License-Identifier: Apache-2.0
#include "server/service/tls.h"

#include <grpcpp/security/tls_certificate_provider.h>
#include <grpcpp/security/tls_credentials_options.h>
#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

constexpr std::uint64_t kMaxPemBytes = 1 << 20;

struct Free {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
};
template <typename T>
using Owned = std::unique_ptr<T, Free>;

absl::StatusOr<Owned<BIO>> ReadPem(const std::string& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxPemBytes));
  Owned<BIO> bio(BIO_new(BIO_s_mem()));
  BIO_write(bio.get(), text.data(), static_cast<int>(text.size()));
  return bio;
}

// The file's first certificate.
absl::StatusOr<Owned<X509>> ReadCertificate(const std::string& path) {
  ASSIGN_OR_RETURN(const auto bio, ReadPem(path));
  Owned<X509> certificate(
      PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
  if (certificate == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": no certificate in PEM form"));
  }
  return certificate;
}

absl::StatusOr<Owned<EVP_PKEY>> ReadKey(const std::string& path) {
  ASSIGN_OR_RETURN(const auto bio, ReadPem(path));
  // Nobody could be asked for a passphrase.
  const auto no_passphrase = [](char*, int, int, void*) { return 0; };
  Owned<EVP_PKEY> key(
      PEM_read_bio_PrivateKey(bio.get(), nullptr, no_passphrase, nullptr));
  if (key == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": no private key in PEM form without passphrase"));
  }
  std::error_code error;
  using std::filesystem::perms;
  const perms permissions = std::filesystem::status(path, error).permissions();
  if (error || (permissions & (perms::others_read | perms::others_write)) !=
                   perms::none) {
    return absl::FailedPreconditionError(absl::StrCat(
        path, ": everybody on this machine can read it; chmod 600"));
  }
  return key;
}

// gRPC would serve nobody, and say so in its own log alone.
absl::Status CheckFiles(const TlsOptions& options) {
  ASSIGN_OR_RETURN(const auto certificate,
                   ReadCertificate(options.certificate));
  ASSIGN_OR_RETURN(const auto key, ReadKey(options.key));
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(options.key, ": not the key of ", options.certificate));
  }
  if (X509_cmp_current_time(X509_get0_notAfter(certificate.get())) < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat(options.certificate, ": expired"));
  }
  if (!options.client_ca.empty()) {
    RETURN_IF_ERROR(ReadCertificate(options.client_ca).status());
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options) {
  if (options.certificate.empty()) return grpc::InsecureServerCredentials();
  RETURN_IF_ERROR(CheckFiles(options));
  namespace tls = grpc::experimental;
  tls::TlsServerCredentialsOptions credentials(
      std::make_shared<tls::FileWatcherCertificateProvider>(
          options.key,
          options.certificate,
          options.client_ca,
          static_cast<unsigned int>(options.reload_interval.count())));
  credentials.watch_identity_key_cert_pairs();
  if (!options.client_ca.empty()) {
    credentials.watch_root_certs();
    credentials.set_cert_request_type(
        options.require_client_certificate
            ? GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY
            : GRPC_SSL_REQUEST_CLIENT_CERTIFICATE_AND_VERIFY);
  }
  return tls::TlsServerCredentials(credentials);
}

}  // namespace groundlock::service
