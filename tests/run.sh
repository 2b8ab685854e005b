#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs what is needed, builds, and runs the tests.
#
#   tests/run.sh             everything that CI runs
#   tests/run.sh --quick     the optimised build and its tests only, without the
#                            benchmarks that no test runs, as in CI
#   tests/run.sh --sanitize  and all tests under the sanitizers (slow)
#   tests/run.sh --tidy      and clang-tidy over all sources (slow)
#   tests/run.sh --all       everything that CI runs (fuzzers for longer),
#                            both of these, the container images, built and run,
#                            the tutorial on a Debian with the packages alone, and
#                            whether a second build makes the same packages: what
#                            is for the night
#   tests/run.sh --perturb [N]  the optimised build; its tests that look at images
#                            in N rounds (20), each with other noise and seeds,
#                            every second one with other last digits (preset
#                            fused): what flips is told (tests/perturb.py)
#   tests/run.sh --repeat N [--loaded]  the optimised build and all its tests N
#                            times, with two busy loops beside them if --loaded
#   tests/run.sh --arm64     a cross build for arm64; the tests of what looks at
#                            images, in an emulator
#
# Tests that need recorded or rendered data look for it in $GROUNDLOCK_DATA
# (default: ../shared/data) and say that they were skipped where it is absent.
set -euo pipefail
cd "$(dirname "$0")/.."

quick=false
tidy=false
sanitize=false
images=false
fuzz_s=20  # each target
benchmarks=OFF
arm64=false
perturb=0
repeat=0
loaded=false
usage() { sed -n '3,22p' "$0" >&2; exit 2; }
case "${1:-}" in
  "") ;;
  --quick) quick=true ;;
  --tidy) tidy=true ;;
  --sanitize) sanitize=true ;;
  --all) tidy=true; sanitize=true; images=true; benchmarks=ON; fuzz_s=300 ;;
  --arm64) arm64=true ;;
  --perturb) perturb=${2:-20} ;;
  --repeat) repeat=${2:-}; [[ "$repeat" =~ ^[1-9][0-9]*$ ]] || usage
    case "${3:-}" in "") ;; --loaded) loaded=true ;; *) usage ;; esac ;;
  *) usage ;;
esac
[[ "$perturb" =~ ^[0-9]+$ ]] || usage

# Two compilers at a time need about 4 GiB: more cores than that only swap.
jobs=$(nproc)
memory_gib=$(awk '/MemTotal/ {print int($2 / 1048576)}' /proc/meminfo)
if [ "$jobs" -gt $((memory_gib / 2 + 1)) ]; then jobs=$((memory_gib / 2 + 1)); fi

start=$SECONDS
step() { printf '\n== %s (%d s so far)\n' "$1" $((SECONDS - start)); }

# Runs tests of a preset, which builds in the folder `$2`; what failed is said
# once more at the end, for it may lie under thousands of lines.
run_tests() {
  local preset=$1 folder=$2 status=0
  shift 2
  ctest --preset "$preset" -j "$jobs" "$@" || status=$?
  if [ "$status" -ne 0 ]; then
    printf '\n== What failed\n'
    grep -ahE -A 8 ': Failure$|^\[  FAILED  \]|ERROR: |panic:' \
      "$folder/Testing/Temporary/LastTest.log" | tail -n 100 || true
  fi
  return "$status"
}

if $arm64; then
  step "Dependencies"
  deploy/setup.sh arm64
  step "Build for arm64"
  cmake --preset arm64 >/dev/null
  cmake --build --preset arm64 -j "$jobs" --target groundlock_vision_tests groundlock-server groundlock
  step "Tests, emulated"
  run_tests arm64 build-arm64 -L vision
  printf '\nAll tests passed in %d s\n' $((SECONDS - start))
  exit 0
fi

step "Dependencies"
deploy/setup.sh

step "Optimised build"
cmake --preset release -DGROUNDLOCK_BENCHMARKS=$benchmarks >/dev/null
cmake --build --preset release -j "$jobs"

if [ "$perturb" -gt 0 ]; then
  step "Build with other last digits"
  cmake --preset fused >/dev/null
  cmake --build --preset fused -j "$jobs" --target groundlock_perturbed_tests
  step "Tests, perturbed"
  tests/perturb.py --build build build-fused --rounds "$perturb" --jobs "$jobs"
  exit 0
fi

if [ "$repeat" -gt 0 ]; then
  if $loaded; then
    for _ in 1 2; do (while :; do :; done) & busy+=($!); done
    trap 'kill "${busy[@]}"' EXIT
  fi
  failed=0
  for ((round = 1; round <= repeat; ++round)); do
    step "Tests, round $round of $repeat"
    run_tests release build || failed=$((failed + 1))
  done
  printf '\n%d of %d rounds failed\n' "$failed" "$repeat"
  [ "$failed" -eq 0 ]
  exit
fi

step "Style and layering"
tests/lint/style.sh
tests/lint/layering.sh

step "Tests"
run_tests release build
if $quick; then
  printf '\nAll quick tests passed in %d s\n' $((SECONDS - start))
  exit 0
fi

step "Address and undefined-behaviour sanitizers: what parses strangers' bytes, and what answers them"
cmake --preset fuzz >/dev/null
cmake --build --preset fuzz -j "$jobs" --target groundlock_fuzzers groundlock_input_tests
run_tests fuzz build-fuzz -L input

step "Fuzz smoke run"
tests/fuzz/smoke.sh build-fuzz/fuzz "$fuzz_s"

step "Thread sanitizer"
cmake --preset tsan >/dev/null
cmake --build --preset tsan -j "$jobs" --target groundlock_concurrent_tests
run_tests tsan build-tsan -L concurrent

if $sanitize; then
  step "Address and undefined-behaviour sanitizers: everything"
  cmake --preset asan >/dev/null
  cmake --build --preset asan -j "$jobs"
  run_tests asan build-asan -LE "data|browser"
fi

if $tidy; then
  step "Static analysis"
  tests/lint/tidy.sh
fi

if $images; then
  step "Container images, a fresh Debian, and a second build"
  deploy/setup.sh images || echo "what they need is not installed" >&2
  for name in images fresh_debian reproducible; do
    code=0
    tests/packages/${name}_test.sh build || code=$?
    # 77: it has said why it cannot run here.
    [ "$code" -eq 0 ] || [ "$code" -eq 77 ]
  done
fi

step "Demo"
deploy/demo.sh --out build/demo --no-serve
tests/eval/demo_lock.py build/demo

printf '\nEverything passed in %d s\n' $((SECONDS - start))
