# SPDX-License-Identifier: Apache-2.0
"""Builds what of the package is generated: groundlock.v1, the messages, from the
protocol's own files, and groundlock/_build.py, which build it is.

The protocol's files are found in the repository, or in a source distribution, which carries
them along. Debian's grpcio-tools brings a protoc older than its protobuf
accepts and without proto3's `optional`; so the protoc of the system is run.
"""
import os
import shutil
import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
FILES = [f"groundlock/v1/{name}.proto" for name in ("geometry", "maps", "tracking")]


def proto_root() -> Path:
    for root in (HERE / "proto", HERE.parent.parent / "proto"):
        if all((root / file).is_file() for file in FILES):
            return root
    raise SystemExit(
        "setup.py: proto/groundlock/v1 is missing: build in a clone of the "
        "repository, or from a source distribution"
    )


def build_name(version: str) -> str:
    """"0.1.0 (1a2b3c4d5e6f)": a source distribution carries its commit along, and a
    clone is asked; "+" after it: the tree had changes. Else the version alone."""
    carried = HERE / "COMMIT"
    if carried.is_file():
        commit = carried.read_text().strip()
    else:
        describe = ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+"]
        try:
            commit = subprocess.run(
                describe, cwd=HERE, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            ).stdout.strip()
        except (OSError, subprocess.CalledProcessError):
            commit = ""
    return f"{version} ({commit})" if commit else version


def generate(out: Path, version: str) -> None:
    protoc = os.environ.get("PROTOC") or shutil.which("protoc")
    if not protoc:
        raise SystemExit(
            "setup.py: protoc is missing: install protobuf-compiler, or name "
            "one of version 3.20 or newer in the environment's PROTOC"
        )
    root = proto_root()
    out.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [protoc, f"-I{root}", f"--python_out={out}", f"--pyi_out={out}", *FILES],
        check=True,
    )
    package = out / "groundlock" / "v1"
    (package / "__init__.py").write_text(
        "# SPDX-License-Identifier: Apache-2.0\n"
        '"""The messages of the protocol, generated from proto/groundlock/v1."""\n'
    )
    (out / "groundlock" / "_build.py").write_text(
        "# SPDX-License-Identifier: Apache-2.0\n"
        '"""Which build this is: the version, and with the commit."""\n'
        f'VERSION = "{version}"\n'
        f'BUILD = "{build_name(version)}"\n'
    )


class Build(build_py):
    def run(self) -> None:
        super().run()
        # Of an editable installation the package lies in the source tree.
        out = HERE if self.editable_mode else Path(self.build_lib)
        generate(out, self.distribution.get_version())


class SourceDistribution(sdist):
    def make_release_tree(self, base_dir, files):
        super().make_release_tree(base_dir, files)
        root = proto_root()
        for file in FILES:
            target = Path(base_dir) / "proto" / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / file, target)
        version = self.distribution.get_version()
        commit = build_name(version)[len(version) :].strip(" ()")
        (Path(base_dir) / "COMMIT").write_text(f"{commit}\n")


setup(cmdclass={"build_py": Build, "sdist": SourceDistribution})
