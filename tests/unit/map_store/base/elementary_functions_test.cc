// SPDX-License-Identifier: Apache-2.0
// What map_store/base/elementary_functions.cc puts in the C library's place.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace groundlock::base {
namespace {

struct Function {
  std::string name;
  double from, to;
  std::function<double(double)> found;
  std::function<long double(long double)> expected;
};

const std::vector<Function>& Functions() {
  using Long = long double;
  static const std::vector<Function> functions = {
      {"sin",
       -50,
       50,
       [](double x) { return std::sin(x); },
       [](Long x) { return std::sin(x); }},
      {"cos",
       -50,
       50,
       [](double x) { return std::cos(x); },
       [](Long x) { return std::cos(x); }},
      {"tan",
       -1.5,
       1.5,
       [](double x) { return std::tan(x); },
       [](Long x) { return std::tan(x); }},
      {"asin",
       -1,
       1,
       [](double x) { return std::asin(x); },
       [](Long x) { return std::asin(x); }},
      {"acos",
       -1,
       1,
       [](double x) { return std::acos(x); },
       [](Long x) { return std::acos(x); }},
      {"atan",
       -9,
       9,
       [](double x) { return std::atan(x); },
       [](Long x) { return std::atan(x); }},
      {"atan2",
       -9,
       9,
       [](double x) { return std::atan2(x, -1.5); },
       [](Long x) { return std::atan2(x, -1.5L); }},
      {"exp",
       -30,
       30,
       [](double x) { return std::exp(x); },
       [](Long x) { return std::exp(x); }},
      {"log",
       1e-9,
       90,
       [](double x) { return std::log(x); },
       [](Long x) { return std::log(x); }},
      {"pow",
       1e-9,
       90,
       [](double x) { return std::pow(x, 1.75); },
       [](Long x) { return std::pow(x, 1.75L); }},
  };
  return functions;
}

constexpr int kSteps = 20'000;

double Argument(const Function& function, int step) {
  return function.from + (function.to - function.from) * step / kSteps;
}

TEST(ElementaryFunctions, AreRightToTheLastDigit) {
  for (const Function& function : Functions()) {
    double worst = 0.0;
    for (int i = 0; i <= kSteps; ++i) {
      const double x = Argument(function, i);
      const long double expected = function.expected(x);
      const auto rounded = static_cast<double>(std::abs(expected));
      const double unit =
          std::nextafter(rounded, std::numeric_limits<double>::infinity()) -
          rounded;
      const auto error = static_cast<double>(
          std::abs(static_cast<long double>(function.found(x)) - expected));
      worst = std::max(worst, error / unit);
    }
    EXPECT_LE(worst, 1.0) << function.name << ", units in the last place";
  }
}

// The bits of many results, mixed (FNV-1a). Another processor, with fused
// multiply-adds or without, has the same.
TEST(ElementaryFunctions, HaveTheSameBitsEverywhere) {
  std::uint64_t mixed = 0xcbf29ce484222325;
  for (const Function& function : Functions()) {
    for (int i = 0; i <= kSteps; ++i) {
      mixed ^=
          std::bit_cast<std::uint64_t>(function.found(Argument(function, i)));
      mixed *= 0x100000001b3;
    }
  }
  EXPECT_EQ(mixed, 0x0f7a948c0e9f2f31U) << std::hex << mixed;
}

TEST(ElementaryFunctions, AnswerWhatHasNoResultAsTheStandardSays) {
  const double infinity = std::numeric_limits<double>::infinity();
  volatile double x = -1.0;  // so that the compiler does not answer
  EXPECT_TRUE(std::isnan(std::log(x)));
  EXPECT_TRUE(std::isnan(std::acos(2 * x)));
  EXPECT_TRUE(std::isnan(std::pow(x, 0.5)));
  x = 0.0;
  EXPECT_EQ(std::log(x), -infinity);
  EXPECT_EQ(std::exp(x), 1.0);
  EXPECT_EQ(std::pow(x, x), 1.0);
  EXPECT_EQ(std::atan2(x, x), 0.0);
  x = 1e4;
  EXPECT_EQ(std::exp(x), infinity);
  EXPECT_EQ(std::exp(-x), 0.0);
  x = infinity;
  EXPECT_TRUE(std::isnan(std::sin(x)));
  EXPECT_EQ(std::atan(x), std::acos(0.0));
  x = std::nan("");
  EXPECT_TRUE(std::isnan(std::cos(x)));
  EXPECT_TRUE(std::isnan(std::exp(x)));
}

// What a library that this program has loaded finds by that name.
TEST(ElementaryFunctions, AreThoseOfTheLibrariesToo) {
  ASSERT_EQ(cv::countNonZero(cv::Mat::eye(2, 2, CV_64F)), 2);
  Dl_info program{};
  ASSERT_NE(dladdr(reinterpret_cast<void*>(&Functions), &program), 0);
  for (const char* name : {"sin", "cos", "exp", "log", "pow", "atan2"}) {
    void* const found = dlsym(RTLD_DEFAULT, name);
    ASSERT_NE(found, nullptr) << name;
    Dl_info info{};
    ASSERT_NE(dladdr(found, &info), 0) << name;
    EXPECT_EQ(info.dli_fbase, program.dli_fbase)
        << name << " is that of " << info.dli_fname;
  }
}

}  // namespace
}  // namespace groundlock::base
