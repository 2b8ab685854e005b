#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether what deploy/ has for Grafana, Prometheus and its adapter works.

    tests/lint/monitoring.py [--bin FOLDER]

What is asked for, the docs name and, with --bin, the running programs expose;
promtool reads every query, and tries every alert (alerts_test.yaml). Without
promtool (Debian's package prometheus) that is left out, and said so.
"""
import argparse
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
MONITORING = ROOT / "deploy/monitoring"
ALERTS_TEST = ROOT / "tests/lint/alerts_test.yaml"
ASKING = [*sorted(MONITORING.iterdir()), ROOT / "deploy/kubernetes/prometheus-adapter.yaml"]
failures = []


def expect(holds, what):
    if not holds:
        failures.append(what)


def names_asked_for():
    """The metrics, without the suffixes of a histogram's series."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in ASKING)
    named = set(re.findall(r"\bgroundlock_[a-z_]+", text))
    # What the adapter makes of them has a name of its own.
    named -= {rule["name"]["as"] for rule in yaml.safe_load(ASKING[-1].read_text(encoding="utf-8"))["rules"]}
    return {re.sub(r"_(bucket|sum|count)$", "", name) for name in named}


def exposed(program, options, folder):
    """The metrics that a program tells of, once it runs."""
    log = folder / f"{program.name}.log"
    with log.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            [program, "--listen", "127.0.0.1:0", "--metrics", "127.0.0.1:0", *options],
            stdout=output, stderr=subprocess.STDOUT, cwd=folder)
    try:
        for _ in range(600):
            found = re.search(r"metrics on port (\d+)", log.read_text(encoding="utf-8"))
            if found or process.poll() is not None:
                break
            time.sleep(0.1)
        if not found:
            failures.append(f"{program.name} tells no port: {log.read_text(encoding='utf-8')}")
            return set()
        with urllib.request.urlopen(f"http://127.0.0.1:{found[1]}/metrics", timeout=60) as answer:
            return set(re.findall(r"^# TYPE (\S+)", answer.read().decode(), re.MULTILINE))
    finally:
        process.terminate()
        process.wait()


def queries():
    """Of the panels; instance: as Grafana would fill it in."""
    panels = json.loads((MONITORING / "grafana.json").read_text(encoding="utf-8"))["panels"]
    expect(panels and all(panel["targets"] for panel in panels), "grafana.json: a panel shows nothing")
    ids = [panel["id"] for panel in panels]
    expect(len(set(ids)) == len(ids), "grafana.json: two panels have one id")
    return [target["expr"].replace("$instance", "a") for panel in panels for target in panel["targets"]]


def promtool(*arguments):
    done = subprocess.run(["promtool", *arguments], capture_output=True, text=True, check=False)
    expect(done.returncode == 0, f"promtool {' '.join(map(str, arguments))}: {done.stdout}{done.stderr}")


def check_rules(folder, asked):
    alerts = yaml.safe_load((MONITORING / "alerts.yaml").read_text(encoding="utf-8"))
    tried = ALERTS_TEST.read_text(encoding="utf-8")
    for group in alerts["groups"]:
        for rule in group["rules"]:
            expect(rule["annotations"]["summary"], f"{rule['alert']}: no summary")
            expect(f'alertname="{rule["alert"]}"' in tried, f"alerts_test.yaml: does not try {rule['alert']}")
    if shutil.which("promtool") is None:
        print("monitoring: no promtool: neither queries nor alerts were tried", file=sys.stderr)
        return
    promtool("check", "rules", MONITORING / "alerts.yaml")
    promtool("test", "rules", ALERTS_TEST)
    # A query by itself promtool does not read; as rules it does.
    rules = [{"record": f"panel:query:{i}", "expr": expr} for i, expr in enumerate(asked)]
    panels = folder / "panels.yaml"
    panels.write_text(yaml.safe_dump({"groups": [{"name": "panels", "rules": rules}]}), encoding="utf-8")
    promtool("check", "rules", panels)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, help="where the programs are")
    arguments = parser.parse_args()
    names = names_asked_for()
    asked = queries()
    expect(len(names) > 30, f"only {len(names)} metrics are asked for: are they read rightly?")
    docs = (ROOT / "docs/operations.md").read_text(encoding="utf-8")
    for name in sorted(names):
        expect(f"`{name}" in docs, f"docs/operations.md: does not name {name}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        check_rules(folder, asked)
        if arguments.bin is not None:
            bin_folder = arguments.bin.resolve()
            known = exposed(bin_folder / "groundlock-server", ["--store", "store"], folder)
            dashboard = bin_folder / "groundlock-dashboard"
            if dashboard.exists():
                known |= exposed(dashboard, ["--server", "127.0.0.1:1", "--data", "data"], folder)
            for name in sorted(names):
                if dashboard.exists() or not name.startswith("groundlock_dashboard_"):
                    expect(name in known, f"no program exposes {name}")
    for failure in failures:
        print(f"monitoring: {failure}", file=sys.stderr)
    if failures:
        return 1
    print(f"monitoring: {len(names)} metrics, {len(asked)} queries: all that is asked for is there")
    return 0


sys.exit(main())
