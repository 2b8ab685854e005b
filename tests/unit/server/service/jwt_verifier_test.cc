// SPDX-License-Identifier: Apache-2.0
#include "server/service/jwt_verifier.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <jwt.h>
#include <openssl/bio.h>
#include <openssl/ec.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/rsa.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/escaping.h"
#include "map_store/base/file.h"

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using std::chrono::seconds;
using std::chrono::system_clock;
using ::testing::HasSubstr;

constexpr char kSecret[] = "a secret of more than thirty-two bytes";

// A key pair in PEM form.
struct Pair {
  explicit Pair(EVP_PKEY* key) {
    const auto text = [](const auto& write) {
      BIO* bio = BIO_new(BIO_s_mem());
      write(bio);
      char* data = nullptr;
      const auto size = BIO_get_mem_data(bio, &data);
      std::string pem(data, static_cast<std::size_t>(size));
      BIO_free(bio);
      return pem;
    };
    open = text([&](BIO* bio) { PEM_write_bio_PUBKEY(bio, key); });
    secret = text([&](BIO* bio) {
      PEM_write_bio_PrivateKey(bio, key, nullptr, nullptr, 0, nullptr, nullptr);
    });
    EVP_PKEY_free(key);
  }
  std::string open;
  std::string secret;
};

std::string Base64(const std::string& text) {
  return absl::WebSafeBase64Escape(text);
}

std::string Sign(jwt_alg_t algorithm,
                 const std::string& key,
                 const json& claims,
                 const std::string& kid) {
  jwt_t* jwt = nullptr;
  EXPECT_EQ(jwt_new(&jwt), 0);
  EXPECT_EQ(jwt_add_grants_json(jwt, claims.dump().c_str()), 0);
  if (!kid.empty()) {
    EXPECT_EQ(jwt_add_header(jwt, "kid", kid.c_str()), 0);
  }
  EXPECT_EQ(jwt_set_alg(jwt,
                        algorithm,
                        reinterpret_cast<const unsigned char*>(key.data()),
                        static_cast<int>(key.size())),
            0);
  char* text = jwt_encode_str(jwt);
  EXPECT_NE(text, nullptr);
  std::string token = text == nullptr ? "" : text;
  std::free(text);
  jwt_free(jwt);
  return token;
}

class JwtTest : public ::testing::Test {
 protected:
  void WriteKey(const std::string& name, const std::string& text) {
    std::ofstream(keys_ / name, std::ios::binary) << text;
    fs::permissions(keys_ / name,
                    fs::perms::owner_read | fs::perms::owner_write);
  }
  std::unique_ptr<JwtVerifier> Load() {
    auto verifier = JwtVerifier::Load({keys_, "https://issuer", "groundlock"});
    EXPECT_TRUE(verifier.ok()) << verifier.status();
    return *std::move(verifier);
  }
  // With these claims changed; null takes one away.
  json Claims(const json& changes = json::object()) const {
    json claims = {{"iss", "https://issuer"},
                   {"aud", "groundlock"},
                   {"sub", "camera-7"},
                   {"tenant", "acme"},
                   {"scope", "openid sessions:own maps:read"},
                   {"exp", 2'000'000'100}};
    claims.merge_patch(changes);
    return claims;
  }
  absl::Status Refusal(const JwtVerifier& verifier, const std::string& token) {
    return verifier.Verify(token, now_).status();
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path keys_ = directory_.path();
  const system_clock::time_point now_{seconds(2'000'000'000)};
};

TEST_F(JwtTest, TellsWhoseTokenItIs) {
  const Pair rsa(EVP_RSA_gen(2048));
  const Pair ec(EVP_EC_gen("P-256"));
  WriteKey("shared.secret", std::string(kSecret) + "\n");
  WriteKey("rsa.pem", rsa.open);
  WriteKey("ec.pem", ec.open);
  const auto verifier = Load();
  for (const std::string& token :
       {Sign(JWT_ALG_HS256, kSecret, Claims(), "shared"),
        Sign(JWT_ALG_RS256, rsa.secret, Claims(), "rsa"),
        Sign(JWT_ALG_ES256, ec.secret, Claims(), "ec"),
        Sign(JWT_ALG_ES256, ec.secret, Claims(), ""),
        Sign(JWT_ALG_HS256,
             kSecret,
             Claims({{"aud", {"another", "groundlock"}}}),
             "")}) {
    const auto principal = verifier->Verify(token, now_);
    ASSERT_TRUE(principal.ok()) << principal.status();
    EXPECT_EQ(principal->name, "jwt:camera-7");
    EXPECT_EQ(principal->tenant, "acme");
    EXPECT_EQ(principal->scopes, Scope::kSessionsOwn | Scope::kMapsRead);
    EXPECT_FALSE(*principal->withdrawn);
  }
}

// RFC 7515, appendices A.1 and A.3, with the keys given there. Their tokens are
// for no audience: who says so has found the signature right.
TEST_F(JwtTest, ChecksSignaturesAsTheStandardDoes) {
  std::string secret;
  ASSERT_TRUE(absl::WebSafeBase64Unescape(
      "AyM1SysPpbyDfgZld3umj1qzKObwVMkoqQ-EstJQLr_T-1qS0gZH75aKtMN3Yj0iPS4hcgUu"
      "TwjAzZr1Z9CAow",
      &secret));
  WriteKey("a.secret", secret);
  WriteKey("b.pem",
           "-----BEGIN PUBLIC KEY-----\n"
           "MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAEf83OJ3D2xF1Bg8vub9tLe1gHMzV7\n"
           "6e8Tus9uPHvRVEXH8UTNG72bfocs3+257rn0s2ldbqkLJK2KRiMohYjlrQ==\n"
           "-----END PUBLIC KEY-----\n");
  const auto verifier = JwtVerifier::Load({keys_, "joe", "groundlock"});
  ASSERT_TRUE(verifier.ok()) << verifier.status();
  const std::string claims =
      "eyJpc3MiOiJqb2UiLA0KICJleHAiOjEzMDA4MTkzODAsDQogImh0dHA6Ly9leGFtcGxlLmNv"
      "bS9pc19yb290Ijp0cnVlfQ.";
  for (const auto& [header, signature] :
       {std::pair<std::string, std::string>(
            "eyJ0eXAiOiJKV1QiLA0KICJhbGciOiJIUzI1NiJ9.",
            "dBjftJeZ4CVP-mB92K27uhbUJU1p1r_wW1gFWFOEjXk"),
        {"eyJhbGciOiJFUzI1NiJ9.",
         "DtEhU3ljbEg8L38VWAfUAqOyKAM6-Xx-F4GawxaepmXFCgfTjDxw5djxLa8ISlSApmWQx"
         "fKTUJqPP3-Kg6NU1Q"}}) {
    EXPECT_THAT(Refusal(**verifier, header + claims + signature).ToString(),
                HasSubstr("another audience"));
    std::string wrong = signature;
    wrong[10] = wrong[10] == 'A' ? 'B' : 'A';
    EXPECT_THAT(Refusal(**verifier, header + claims + wrong).ToString(),
                HasSubstr("signature is wrong"));
    EXPECT_THAT(Refusal(**verifier, header + "eyJpc3MiOiJqb2UifQ." + signature)
                    .ToString(),
                HasSubstr("signature is wrong"));
  }
}

TEST_F(JwtTest, RefusesWhatIsNotMeantForIt) {
  WriteKey("shared.secret", kSecret);
  const auto verifier = Load();
  const std::pair<json, const char*> cases[] = {
      {{{"iss", "https://other"}}, "issuer"},
      {{{"iss", nullptr}}, "issuer"},
      {{{"aud", "other"}}, "audience"},
      {{{"aud", nullptr}}, "audience"},
      {{{"aud", {1, 2}}}, "audience"},
      {{{"exp", nullptr}}, "no exp"},
      {{{"exp", "2000000100"}}, "exp is not a number"},
      {{{"exp", 1e300}}, "out of range"},
      {{{"exp", 1'999'999'969}}, "expired"},
      {{{"nbf", 2'000'000'031}}, "not valid yet"},
      {{{"sub", nullptr}}, "sub"},
      {{{"sub", "two words"}}, "sub"},
      {{{"sub", std::string(129, 'x')}}, "sub"},
      {{{"tenant", "a/b"}}, "tenant"},
      {{{"tenant", 7}}, "tenant"},
  };
  for (const auto& [changes, why] : cases) {
    const absl::Status refusal = Refusal(
        *verifier, Sign(JWT_ALG_HS256, kSecret, Claims(changes), "shared"));
    EXPECT_EQ(refusal.code(), absl::StatusCode::kUnauthenticated) << changes;
    EXPECT_THAT(refusal.ToString(), HasSubstr(why)) << changes;
  }
  // Within the half minute by which clocks may differ.
  for (const json& changes : {json{{"exp", 1'999'999'971}},
                              json{{"nbf", 2'000'000'029}},
                              json{{"exp", 20'000'000'000}}}) {
    EXPECT_TRUE(Refusal(*verifier,
                        Sign(JWT_ALG_HS256, kSecret, Claims(changes), "shared"))
                    .ok());
  }
  // Without scopes of ours nothing may be done, which the gate says.
  const auto nobody = verifier->Verify(
      Sign(JWT_ALG_HS256, kSecret, Claims({{"scope", "openid"}}), ""), now_);
  ASSERT_TRUE(nobody.ok());
  EXPECT_EQ(nobody->scopes, kNoScopes);
}

TEST_F(JwtTest, TheKeyDecidesOnTheAlgorithm) {
  const Pair rsa(EVP_RSA_gen(2048));
  const Pair other(EVP_RSA_gen(2048));
  WriteKey("rsa.pem", rsa.open);
  const auto verifier = Load();
  const std::string claims = Base64(Claims().dump());
  // Everybody knows the public key; it must not serve as a secret.
  EXPECT_THAT(Refusal(*verifier, Sign(JWT_ALG_HS256, rsa.open, Claims(), "rsa"))
                  .ToString(),
              HasSubstr("no key is known"));
  for (const char* header : {R"({"alg":"none"})",
                             R"({"alg":"NONE","kid":"rsa"})",
                             R"({"alg":"RS384","kid":"rsa"})",
                             R"({"kid":"rsa"})",
                             R"({"alg":"RS256","kid":"rsa","crit":["x"]})",
                             R"({"alg":"RS256","kid":"../rsa"})",
                             R"(["RS256"])",
                             "no json"}) {
    EXPECT_EQ(Refusal(*verifier, Base64(header) + "." + claims + ".").code(),
              absl::StatusCode::kUnauthenticated)
        << header;
  }
  EXPECT_THAT(
      Refusal(*verifier, Sign(JWT_ALG_RS256, other.secret, Claims(), "rsa"))
          .ToString(),
      HasSubstr("signature is wrong"));
  for (const char* token :
       {"", ".", "..", "a.b", "a.b.c.d", "\xff.\xff.\xff"}) {
    EXPECT_FALSE(Refusal(*verifier, token).ok()) << token;
  }
}

TEST_F(JwtTest, KeysOfAnotherKindAreNamed) {
  const auto refusal = [this](const std::string& name,
                              const std::string& text) {
    WriteKey(name, text);
    const absl::Status status =
        JwtVerifier::Load({keys_, "https://issuer", "groundlock"}).status();
    fs::remove(keys_ / name);
    EXPECT_THAT(status.ToString(), HasSubstr(name));
    return status.ToString();
  };
  EXPECT_THAT(refusal("a.secret", "short"), HasSubstr("32 to 1024 bytes"));
  EXPECT_THAT(refusal("a.pem", "no key"), HasSubstr("no public key"));
  EXPECT_THAT(refusal("a.pem", Pair(EVP_RSA_gen(1024)).open),
              HasSubstr("2048 bits"));
  EXPECT_THAT(refusal("a.pem", Pair(EVP_EC_gen("P-384")).open),
              HasSubstr("P-256"));
  EXPECT_THAT(refusal("a.pem", Pair(EVP_EC_gen("P-256")).secret),
              HasSubstr("no public key"));
  WriteKey("a.secret", kSecret);
  fs::permissions(
      keys_ / "a.secret", fs::perms::others_read, fs::perm_options::add);
  EXPECT_THAT(JwtVerifier::Load({keys_, "i", "a"}).status().ToString(),
              HasSubstr("chmod 600"));
  fs::remove(keys_ / "a.secret");
  EXPECT_EQ(JwtVerifier::Load({keys_, "i", "a"}).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(JwtVerifier::Load({keys_ / "none", "i", "a"}).status().code(),
            absl::StatusCode::kNotFound);
}

TEST_F(JwtTest, AKeyThatGoesTakesItsTokensAlong) {
  WriteKey("old.secret", kSecret);
  WriteKey("stays.secret", std::string(kSecret) + "2");
  const auto before = Load();
  const auto old = *before->Verify(
      Sign(JWT_ALG_HS256, kSecret, Claims(), "old"), system_clock::now());
  const auto stays = *before->Verify(Sign(JWT_ALG_HS256,
                                          std::string(kSecret) + "2",
                                          Claims({{"exp", 4'000'000'000}}),
                                          "stays"),
                                     now_);
  const std::string look = JwtVerifier::LookOf(keys_);
  fs::remove(keys_ / "old.secret");
  EXPECT_NE(JwtVerifier::LookOf(keys_), look);
  const auto after = Load();
  before->Withdraw(after.get());
  EXPECT_TRUE(*old.withdrawn);
  EXPECT_FALSE(old.CheckValid().ok());
  EXPECT_FALSE(*stays.withdrawn);
  EXPECT_TRUE(stays.CheckValid().ok());
}

}  // namespace
}  // namespace groundlock::service
