# SPDX-License-Identifier: Apache-2.0
"""Builds groundlock.v1, the messages, from the protocol's own files.

They are found in the repository, or in a source distribution, which carries
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


def generate(out: Path) -> None:
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


class Build(build_py):
    def run(self) -> None:
        super().run()
        # Of an editable installation the package lies in the source tree.
        generate(HERE if self.editable_mode else Path(self.build_lib))


class SourceDistribution(sdist):
    def make_release_tree(self, base_dir, files):
        super().make_release_tree(base_dir, files)
        root = proto_root()
        for file in FILES:
            target = Path(base_dir) / "proto" / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / file, target)


setup(cmdclass={"build_py": Build, "sdist": SourceDistribution})
