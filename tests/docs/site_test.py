#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The site is rendered (docs/site/build.py follows every link of it), can be
searched, and its references miss nothing that is public. Exits with 77 without
mkdocs, npm or protoc."""
from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.dont_write_bytecode = True
sys.path.insert(0, str(ROOT / "docs" / "site"))
import reference  # noqa: E402


def main() -> int:
    for program in ("mkdocs", "npm", "protoc"):
        if not shutil.which(program):
            print(f"SKIPPED: there is no {program}", file=sys.stderr)
            return 77
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "site"
        subprocess.run([sys.executable, "-B", ROOT / "docs" / "site" / "build.py", "--out", out], check=True)
        headings = {}
        for page in ("proto", "cpp", "python", "typescript"):
            text = (out / "reference" / f"{page}.html").read_text()
            headings[page] = set(re.findall(r"<h3[^>]*>([^<]*)</h3>", text))
            if page == "proto":
                calls = set(re.findall(r"rpc (\w+)", text))
        search = json.loads((out / "search" / "search_index.json").read_text())["docs"]

    missing = []
    for path in sorted((ROOT / "proto" / "groundlock" / "v1").glob("*.proto")):
        text = re.sub(r"//.*", "", path.read_text())
        missing += [f"{path.name}: rpc {n}" for n in re.findall(r"\brpc (\w+)", text) if n not in calls]
        for kind, n in re.findall(r"^(message|enum|service) (\w+)", text, re.M):
            if f"{kind} {n}" not in headings["proto"]:
                missing.append(f"{path.name}: {kind} {n}")
    for header in reference.HEADERS:
        text = (ROOT / header).read_text()
        for n in re.findall(r"^(?:class|struct|enum class) (\w+)(?: final)?(?: :[^{;]*)? \{", text, re.M):
            if n not in headings["cpp"]:
                missing.append(f"{header}: {n}")
    names = set(reference.public_names(ROOT)) - {"aio"}  # a module, with a section of its own
    missing += [f"groundlock.{n}" for n in sorted(names) if n not in headings["python"] and not n.startswith("__")]
    index = (ROOT / "client" / "typescript" / "src" / "index.ts").read_text()
    for exported in re.findall(r"export (?:type )?\{(.*?)\}", index, re.S):
        missing += [f"index.ts: {n}" for n in re.findall(r"\w+", exported) if n not in headings["typescript"]]
    browser = (ROOT / "client" / "typescript" / "src" / "browser.ts").read_text()
    for n in re.findall(r"^export (?:class|interface) (\w+)", browser, re.M):
        if n not in headings["typescript"]:
            missing.append(f"browser.ts: {n}")
    for word, page in (("occlusion", "tutorial.html"), ("SetTarget", "reference/proto.html")):
        if not any(word in doc["text"] + doc["title"] and doc["location"].startswith(page) for doc in search):
            missing.append(f"search: {word} in {page}")
    if missing:
        print("FAILED: not in the site:\n  " + "\n  ".join(missing), file=sys.stderr)
        return 1
    print("site:", ", ".join(f"{len(h)} headings of {p}" for p, h in headings.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
