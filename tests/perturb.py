#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the tests that look at images again and again, each round with other noise and seeds, and says
which of them fail in which rounds: what they assert, or what they test, hangs on a hair.

  tests/perturb.py [--build build ...] [--rounds N] [--first N] [--tests REGEX] [--cpu CPU ...]

A round is GROUNDLOCK_PERTURBATION=1, 2, ... (tests/support/perturbation.h) over CTest's label `perturbed`. Of several
builds each round takes the next, e.g. of `build build-fused`, where the preset `fused` has made other last digits in
everything that is reckoned. --cpu: instead of that, once as is under qemu-x86_64 as each of these processors, e.g.
Nehalem Haswell EPYC.
Exits with 1 if anything failed."""
import argparse, collections, json, os, re, subprocess, sys, time
from concurrent.futures import ThreadPoolExecutor


def listed(build, pattern):
    """The tests' commands and properties by name."""
    listing = subprocess.run(["ctest", "--test-dir", build, "-L", "perturbed", "-R", pattern, "--show-only=json-v1"],
                             check=True, stdout=subprocess.PIPE).stdout
    tests = {}
    for test in json.loads(listing)["tests"]:
        if "command" not in test:
            raise SystemExit(f"{test['name']}: not built")
        properties = {p["name"]: p["value"] for p in test["properties"]}
        tests[test["name"]] = (test["command"], properties.get("WORKING_DIRECTORY"), properties.get("TIMEOUT", 300))
    return tests


def failures(test, prefix, environment, patience):
    """What failed in a run of it: GoogleTest's names, else how it ended."""
    command, folder, timeout_s = test
    try:
        done = subprocess.run([*prefix, *command], cwd=folder, env={**os.environ, **environment}, text=True,
                              timeout=patience * timeout_s, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    except subprocess.TimeoutExpired:
        return {"(ran out of time)": ""}
    if done.returncode == 0:
        return {}
    found = {}
    for name in re.findall(r"^\[  FAILED  \] ([\w/]+\.[\w/]+)", done.stdout, re.MULTILINE):
        # What it said between its start and its end.
        said = re.search(rf"^\[ RUN      \] {re.escape(name)}\n(.*?)^\[  FAILED  \] ", done.stdout,
                         re.MULTILINE | re.DOTALL)
        found.setdefault(name, said.group(1).strip() if said else "")
    return found or {f"(ended with {done.returncode})": done.stdout[-2000:]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", nargs="+", default=["build"])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="number of the first round")
    parser.add_argument("--tests", default=".", metavar="REGEX")
    parser.add_argument("--cpu", nargs="+", default=[])
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    tests_of = {build: listed(build, arguments.tests) for build in arguments.build}
    if not all(tests_of.values()):
        raise SystemExit("no such tests")
    if arguments.cpu:
        rounds = [(cpu, ["qemu-x86_64", "-cpu", cpu], {}, 40) for cpu in arguments.cpu]
    else:
        rounds = [(str(n), [], {"GROUNDLOCK_PERTURBATION": str(n)}, 2)
                  for n in range(arguments.first, arguments.first + arguments.rounds)]
    flips = collections.defaultdict(list)
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for number, (label, prefix, environment, patience) in enumerate(rounds):
            build = arguments.build[number % len(arguments.build)]
            tests = tests_of[build]
            label += f" ({build})" if len(arguments.build) > 1 else ""
            start = time.time()
            results = pool.map(lambda test: failures(test, prefix, environment, patience), tests.values())
            failed = 0
            for name, found in zip(tests, results):
                for what, said in found.items():
                    failed += 1
                    flips[f"{name} {what}"].append(label)
                    print(f"  {label}: {name} {what}\n    " + said.replace("\n", "\n    "), flush=True)
            print(f"round {label}: {len(tests)} tests, {failed} failures ({time.time() - start:.0f} s)", flush=True)
    for what, labels in sorted(flips.items()):
        print(f"FLIPS {what}: rounds {', '.join(labels)}")
    print(f"{len(flips)} of what {len(tests)} tests check flipped in {len(rounds)} rounds")
    return 1 if flips else 0


if __name__ == "__main__":
    sys.exit(main())
