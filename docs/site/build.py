#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Renders the documents as a site that can be searched, with the references of
protocol, C++, Python and TypeScript from the sources' comments.

    docs/site/build.py [--out FOLDER]        default: out/site

Needs Debian's mkdocs; for TypeScript's page node and npm. Every link of the site
is followed; one that leads nowhere fails the build.
"""
from __future__ import annotations

import argparse
import html.parser
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import urllib.parse
from pathlib import Path

import reference

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ("Start", "index.md"),
    ("Tutorial", "tutorial.md"),
    ("User guide", "user_guide.md"),
    ("Operations", "operations.md"),
    ("API", "api.md"),
    ("C++", "cpp.md"),
    ("Python", "python.md"),
    ("TypeScript", "typescript.md"),
    ("Reference", [
        ("Protocol", "reference/proto.md"),
        ("C++", "reference/cpp.md"),
        ("Python", "reference/python.md"),
        ("TypeScript", "reference/typescript.md"),
    ]),
    ("Method", "method.md"),
    ("Evidence", "evidence.md"),
    ("Benchmarks", "benchmarks.md"),
    ("Architecture", "architecture.md"),
    ("Map file", "map_file.md"),
]


def write_sources(source: Path, declarations: Path) -> None:
    docs = ROOT / "docs"
    shutil.copytree(docs / "images", source / "images")
    wanted: set[str] = set()
    for path in [*sorted(docs.glob("*.md")), ROOT / "README.md"]:
        name = "index.md" if path.name == "README.md" else path.name
        (source / name).write_text(_links_within(path.read_text(), path.parent, wanted))
    for target in sorted(wanted):
        _publish(ROOT / target, source / "files" / target)
    (source / "reference").mkdir()
    for name, text in (
        ("proto", reference.proto(ROOT)),
        ("cpp", reference.cpp(ROOT)),
        ("python", reference.python(ROOT)),
        ("typescript", reference.typescript(ROOT, declarations)),
    ):
        (source / "reference" / f"{name}.md").write_text(text)


def _links_within(text: str, folder: Path, wanted: set[str]) -> str:
    """Links to files of the repository lead to copies of them in the site."""

    def relink(match: re.Match) -> str:
        target, anchor = match.group(1), match.group(2) or ""
        if re.match(r"[a-z]+:", target) or not target:
            return match.group(0)
        path = (folder / target).resolve()
        relative = path.relative_to(ROOT)
        if not path.exists():
            raise SystemExit(f"docs/site: {folder.name}: the link {target} leads nowhere")
        if relative.parts[0] == "docs":
            return f"]({relative.relative_to('docs')}{anchor})"
        wanted.add(str(relative))
        return f"](files/{relative}{'/index.md' if path.is_dir() else ''}{anchor})"

    return re.sub(r"\]\(([^)#\s]*)(#[^)\s]*)?\)", relink, text)


def _publish(path: Path, target: Path) -> None:
    if path.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
        return
    made = {"node_modules", "dist", "gen", "build", "__pycache__"}
    listed = sorted(
        str(file.relative_to(path))
        for file in path.rglob("*")
        if file.is_file() and not file.name.startswith(".") and not made.intersection(file.relative_to(path).parts)
    )
    target.mkdir(parents=True, exist_ok=True)
    page = [f"# {path.relative_to(ROOT)}", ""]
    for name in listed:
        if name.endswith(".md"):  # would become a page of its own
            continue
        copy = target / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path / name, copy)
        page.append(f"- [{name}]({name})")
    (target / "index.md").write_text("\n".join(page) + "\n")


def declarations_of_typescript(folder: Path) -> Path:
    """tsc's .d.ts files, made from a copy: building leaves files beside the sources."""
    client = ROOT / "client" / "typescript"
    if not (client / "node_modules" / "typescript").is_dir():
        subprocess.run(
            ["npm", "install", "--no-save", "--no-audit", "--no-fund", "--loglevel=error"], cwd=client, check=True
        )
    copy = folder / "client" / "typescript"
    shutil.copytree(client, copy, ignore=shutil.ignore_patterns("node_modules", "dist", "gen"))
    (copy / "node_modules").symlink_to(client / "node_modules")
    (folder / "proto").symlink_to(ROOT / "proto")
    subprocess.run(["npm", "run", "--silent", "build"], cwd=copy, check=True)
    return copy / "dist"


class Page(html.parser.HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        for key, value in attrs:
            if key == "id" and value:
                self.ids.add(value)
            elif key in ("href", "src") and value:
                self.links.append(value)


def broken_links(out: Path) -> list[str]:
    pages = {path: Page(path.read_text()) for path in out.rglob("*.html")}
    broken = []
    for path, page in pages.items():
        if path.name == "404.html":  # its links are from the root of wherever the site lies
            continue
        for link in page.links:
            url = urllib.parse.urlparse(link)
            if url.scheme or url.netloc:
                if not link.startswith(("https:", "http:", "mailto:", "data:")):
                    broken.append(f"{path.relative_to(out)}: {link}")
                continue
            target = path
            if url.path:
                target = Path(os.path.normpath(path.parent / urllib.parse.unquote(url.path)))
                if target.is_dir():
                    target = target / "index.html"
            if not target.exists():
                broken.append(f"{path.relative_to(out)}: {link}")
            elif url.fragment and target in pages and url.fragment not in pages[target].ids:
                broken.append(f"{path.relative_to(out)}: {link} (no such heading)")
    return broken


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "site")
    out = parser.parse_args().out.absolute()
    for program in ("mkdocs", "npm", "protoc"):
        if not shutil.which(program):
            sys.exit(f"docs/site: there is no {program}: apt-get install mkdocs npm protobuf-compiler")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = folder / "source"
        source.mkdir()
        write_sources(source, declarations_of_typescript(folder))

        def nav(pages):
            return [{title: nav(page) if isinstance(page, list) else page} for title, page in pages]

        # JSON is YAML.
        (folder / "mkdocs.yml").write_text(json.dumps({
            "site_name": "Groundlock",
            "docs_dir": str(source),
            "site_dir": str(out),
            "theme": {"name": "mkdocs", "highlightjs": False},
            "use_directory_urls": False,  # it can be read from a folder, too
            "plugins": ["search"],
            "nav": nav(PAGES),
        }))
        subprocess.run(["mkdocs", "build", "--quiet", "--clean", "-f", folder / "mkdocs.yml"], check=True)
    broken = broken_links(out)
    if broken:
        sys.exit("docs/site: links that lead nowhere:\n  " + "\n  ".join(broken))
    print(f"docs/site: {len(list(out.rglob('*.html')))} pages in {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
