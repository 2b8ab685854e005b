# SPDX-License-Identifier: Apache-2.0
"""The API references as Markdown, from the comments of the sources themselves."""
from __future__ import annotations

import ast
import re
from pathlib import Path

# What client/sdk/client.h leads to, in the order in which one reads it.
HEADERS = [
    "client/sdk/client.h",
    "client/sdk/tracking_stream.h",
    "client/sdk/types.h",
    "client/sdk/map_types.h",
    "map_store/geometry/camera_model.h",
    "map_store/geometry/box.h",
    "map_store/geometry/rigid3.h",
    "map_store/geometry/similarity3.h",
    "map_store/geometry/plane.h",
    "map_store/geometry/geodesy.h",
]
PROTOS = ["tracking", "maps", "geometry"]


def prose(lines: list[str]) -> str:
    """Comment lines as text in which nothing is markup by accident."""
    return "\n".join(re.sub(r"([<>*_|\[\]])", r"\\\1", line) for line in lines)


def uncommented(line: str) -> str:
    return re.sub(r"^\s*// ?", "", line)


# Protocol -----------------------------------------------------------------


def proto(root: Path) -> str:
    page = ["# Protocol", "", "The messages and calls of `groundlock.v1`, from the comments of the `.proto` files."]
    for name in PROTOS:
        text = (root / "proto" / "groundlock" / "v1" / f"{name}.proto").read_text()
        page += ["", f"## {name}.proto", ""] + _proto_file(text)
    return "\n".join(page) + "\n"


def _proto_file(text: str) -> list[str]:
    page: list[str] = []
    comment: list[str] = []
    open_blocks: list[str] = []
    statement = ""
    for line in text.splitlines():
        line = line.strip()
        if not statement and line.startswith("//"):
            comment.append(uncommented(line))
            continue
        if not line:
            comment = []
            continue
        code, _, trailing = line.partition("//")
        statement = f"{statement} {code.strip()}".strip()
        if trailing:
            comment.append(trailing.strip())
        if not re.search(r"[;{}]$", statement):
            continue
        words, statement = statement, ""
        empty = re.match(r"message (\w+) \{\s*\}$", words)
        if empty:
            page += ["", f"### message {empty.group(1)}", "", prose(comment) or "Empty.", ""]
            comment = []
            continue
        block = re.match(r"(message|enum|service|oneof) (\w+) \{$", words)
        if block:
            kind, name = block.groups()
            open_blocks.append("" if kind == "oneof" else name)
            if kind == "oneof":
                page += ["", f"One of these (`{name}`):"] if not comment else ["", f"One of these (`{name}`): {prose(comment)}"]
            else:
                full = ".".join(b for b in open_blocks if b)
                page += ["", f"### {kind} {full}", "", prose(comment), ""]
        elif words == "}":
            closed = open_blocks.pop()
            full = ".".join(b for b in open_blocks if b)
            if closed and full:
                page += ["", f"Further fields of `{full}`:", ""]
        elif open_blocks:
            declared = words.rstrip(";{ ").strip()
            page.append(f"- `{declared}`" + (f"  \n  {prose([' '.join(comment)])}" if comment else ""))
            if words.endswith("{"):
                open_blocks.append("")
        comment = []
    return page


# C++ ----------------------------------------------------------------------


def cpp(root: Path) -> str:
    page = ["# C++", "", "What `#include \"client/sdk/client.h\"` brings. How to use it: [C++](../cpp.md)."]
    for header in HEADERS:
        text = (root / header).read_text()
        about = [uncommented(l) for l in text.splitlines()[1:] if l.startswith("//")]
        until_guard = text.split("#ifndef", 1)[0].splitlines()[1:]
        about = [uncommented(l) for l in until_guard if l.startswith("//")]
        page += ["", f"## {header}", "", prose(about)]
        body = text.split("namespace groundlock", 1)[1].split("{", 1)[1].rsplit("}  // namespace", 1)[0]
        for comment, code in _declarations(body):
            name = re.search(r"(?:class|struct|enum class) (\w+)", code) or re.search(r"(\w+)\s*(?:=|\()", code)
            if not name or name.group(1) == "operator":
                continue
            page += ["", f"### {name.group(1)}", "", prose(comment), "", "```c++", _public(code), "```"]
    return "\n".join(page) + "\n"


def _declarations(body: str):
    """(comment, code) of each declaration at the namespace's level."""
    comment: list[str] = []
    code: list[str] = []
    depth = 0
    for line in body.splitlines():
        if not code and not line.strip():
            comment = []
        elif not code and line.startswith("//"):
            comment.append(uncommented(line))
        else:
            code.append(line)
            stripped = line.split("//")[0]
            depth += sum(stripped.count(c) for c in "({") - sum(stripped.count(c) for c in ")}")
            if depth == 0 and re.search(r"[;}]\s*$", stripped):
                if not re.match(r"(class|struct) \w+;", code[0]):
                    yield comment, "\n".join(code)
                comment, code = [], []


def _public(code: str) -> str:
    return re.sub(r"\n private:.*?(?=\n\};)", "", code, flags=re.S)


# Python -------------------------------------------------------------------


def python(root: Path) -> str:
    package = root / "client" / "python" / "groundlock"
    defined: dict[str, tuple[str, ast.stmt, str]] = {}
    for path in sorted(package.glob("*.py")):
        text = path.read_text()
        for node in ast.parse(text).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and path.name != "aio.py":
                defined[node.name] = (path.name, node, text)
            elif isinstance(node, (ast.Assign, ast.AnnAssign)):
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                if isinstance(target, ast.Name) and target.id in public_names(root):
                    defined[target.id] = (path.name, node, text)
    page = ["# Python", "", "The names of the package `groundlock`. How to use them: [Python](../python.md)."]
    for name in public_names(root):
        if name in defined:
            page += _python_thing(*defined[name][1:])
    text = (package / "aio.py").read_text()
    page += ["", "## groundlock.aio", "", _docstring(ast.parse(text))]
    for node in ast.parse(text).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and not node.name.startswith("_"):
            page += _python_thing(node, text, "aio.")
    return "\n".join(page) + "\n"


def public_names(root: Path) -> list[str]:
    """__all__ of the package."""
    tree = ast.parse((root / "client" / "python" / "groundlock" / "__init__.py").read_text())
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return [ast.literal_eval(e) for e in node.value.elts]  # type: ignore[attr-defined]
    # Without a list it is what is imported from within.
    return sorted(
        a.asname or a.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for a in node.names
    )


def _docstring(node) -> str:
    return prose((ast.get_docstring(node) or "").splitlines())


def _signature(node) -> str:
    word = "async def" if isinstance(node, ast.AsyncFunctionDef) else "def"
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    text = f"{word} {node.name}({ast.unparse(node.args)}){returns}"
    return text if len(text) < 100 else text.replace(", ", ",\n    ")


def _python_thing(node, text: str, prefix: str = "") -> list[str]:
    if isinstance(node, (ast.Assign, ast.AnnAssign)):  # a constant, or another name of a type
        name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
        return ["", f"### {name}", "", "```python", ast.get_source_segment(text, node) or "", "```"]
    if not isinstance(node, ast.ClassDef):
        return ["", f"### {prefix}{node.name}", "", "```python", _signature(node), "```", "", _docstring(node)]
    bases = ", ".join(ast.unparse(b) for b in node.bases)
    page = ["", f"### {prefix}{node.name}", "", f"Is a `{bases}`." if bases else "", "", _docstring(node)]
    lines = text.splitlines()
    fields = []
    for member in node.body:
        if isinstance(member, (ast.AnnAssign, ast.Assign)):
            first = member.lineno - 1
            while lines[first - 1].strip().startswith("#"):
                first -= 1
            fields += [line[4:] for line in lines[first : member.end_lineno]]
    if fields:
        page += ["", "```python", *fields, "```"]
    for member in node.body:
        if not isinstance(member, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if member.name.startswith("_") and member.name != "__init__":
            continue
        if member.name == "__init__" and not ast.get_docstring(member):
            continue
        page += ["", "```python", _signature(member), "```", "", _docstring(member)]
    return page


# TypeScript ---------------------------------------------------------------


def typescript(root: Path, declarations: Path) -> str:
    """declarations: the folder of tsc's .d.ts files."""
    page = ["# TypeScript", "", "What the package `groundlock` exports. How to use it: [TypeScript](../typescript.md)."]
    index = (root / "client" / "typescript" / "src" / "index.ts").read_text()
    for names, module in re.findall(r"export (?:type )?(\{.*?\}|\*) from \"\./([\w/]+)\.js\"", index, re.S):
        wanted = set(re.findall(r"\w+", names))
        text = (declarations / f"{module}.d.ts").read_text()
        for comment, code in _exports(text):
            name = re.search(r"(?:class|interface|type|const|function|enum) (\w+)", code)
            if name and (names == "*" or name.group(1) in wanted):
                page += ["", f"### {name.group(1)}", "", prose(comment), "", "```ts", code, "```"]
    page += ["", "## groundlock/browser", "", "For pages: through groundlock-dashboard. Types are those above."]
    for comment, code in _exports((declarations / "browser.d.ts").read_text()):
        name = re.search(r"(?:class|interface) (\w+)", code)
        if name:
            page += ["", f"### {name.group(1)}", "", prose(comment), "", "```ts", code, "```"]
    return "\n".join(page) + "\n"


def _exports(text: str):
    comment: list[str] = []
    code: list[str] = []
    depth = 0
    in_comment = False
    for line in text.splitlines():
        if not code and (in_comment or line.startswith("/**")):
            in_comment = "*/" not in line
            if line.startswith("/**"):
                comment = []
            comment.append(re.sub(r"^\s*(/\*\*|\*(?!/))? ?|\s*\*/$", "", line))
        elif code or line.startswith("export"):
            code.append(line)
            depth += sum(line.count(c) for c in "({") - sum(line.count(c) for c in ")}")
            if depth == 0 and re.search(r"[;}]\s*$", line):
                yield comment, "\n".join(code)
                comment, code = [], []
        else:
            comment = []
