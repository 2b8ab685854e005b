// SPDX-License-Identifier: Apache-2.0
// The C library's elementary functions, replaced for the whole program and the
// libraries that it loads: glibc chooses its own by the processor (with fused
// multiply-adds or without), and they differ in the last digit. These are
// SLEEF's deterministic ones (Shibata, Petrogalli: "SLEEF: A Portable
// Vectorized Library of C Standard Mathematical Functions", IEEE TPDS 31(6),
// 2020): plain C without fused operations, errors up to 1.0 unit in the last
// place, the same bits on every processor. Those of glibc's functions of which
// there are several on x86-64 are here, and no others.
//
// Thread-safe; errno is not set.
#include <sleef.h>

extern "C" {

// Linkers take this file into every program because of this name
// (CMakeLists.txt), whether or not the program itself calls any of these.
void groundlock_elementary_functions() {}

double sin(double x) noexcept { return Sleef_cinz_sind1_u10purec(x); }
double cos(double x) noexcept { return Sleef_cinz_cosd1_u10purec(x); }
double tan(double x) noexcept { return Sleef_cinz_tand1_u10purec(x); }
double asin(double x) noexcept { return Sleef_cinz_asind1_u10purec(x); }
double acos(double x) noexcept { return Sleef_cinz_acosd1_u10purec(x); }
double atan(double x) noexcept { return Sleef_cinz_atand1_u10purec(x); }
double atan2(double y, double x) noexcept {
  return Sleef_cinz_atan2d1_u10purec(y, x);
}
double exp(double x) noexcept { return Sleef_cinz_expd1_u10purec(x); }
double log(double x) noexcept { return Sleef_cinz_logd1_u10purec(x); }
double pow(double x, double y) noexcept {
  return Sleef_cinz_powd1_u10purec(x, y);
}
void sincos(double x, double* sine, double* cosine) noexcept {
  const Sleef_double_2 both = Sleef_cinz_sincosd1_u10purec(x);
  *sine = both.x;
  *cosine = both.y;
}

float sinf(float x) noexcept { return Sleef_cinz_sinf1_u10purec(x); }
float cosf(float x) noexcept { return Sleef_cinz_cosf1_u10purec(x); }
float expf(float x) noexcept { return Sleef_cinz_expf1_u10purec(x); }
float exp2f(float x) noexcept { return Sleef_cinz_exp2f1_u10purec(x); }
float logf(float x) noexcept { return Sleef_cinz_logf1_u10purec(x); }
float log2f(float x) noexcept { return Sleef_cinz_log2f1_u10purec(x); }
float powf(float x, float y) noexcept {
  return Sleef_cinz_powf1_u10purec(x, y);
}
void sincosf(float x, float* sine, float* cosine) noexcept {
  const Sleef_float_2 both = Sleef_cinz_sincosf1_u10purec(x);
  *sine = both.x;
  *cosine = both.y;
}

}  // extern "C"
