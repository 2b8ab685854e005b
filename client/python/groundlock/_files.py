# SPDX-License-Identifier: Apache-2.0
"""Files to and from the server."""
from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Dict, Iterable, Iterator, List, Optional, Sequence, Tuple, Union

from ._values import choice
from .errors import (
    AlreadyExistsError,
    DataLossError,
    FailedPreconditionError,
    InternalError,
    NotFoundError,
    ResourceExhaustedError,
    bad_argument,
)
from .maps import MapExportFormat, MapFormat, Progress

PathLike = Union[str, "os.PathLike[str]"]

# A quarter of what the server takes: progress moves visibly.
CHUNK_BYTES = 256 << 10


@dataclass(frozen=True)
class LocalFile:
    """A file to upload: where it lies here, and its path over there."""

    path: Path
    remote: str


@dataclass(frozen=True)
class ImportFiles:
    """What an import sends: see ImportMapRequest.Header."""

    format: MapFormat
    files: Tuple[LocalFile, ...]
    model: str
    database: str = ""
    images: str = ""


class Upload:
    """The messages of an upload, and how far it is."""

    def __init__(self, files: Sequence[LocalFile]) -> None:
        self.files = files
        self.done = 0
        self.total = 0
        self.complete = False
        self.error: Optional[BaseException] = None
        for file in files:
            try:
                self.total += file.path.stat().st_size
            except OSError as error:
                raise NotFoundError(f"{file.path}: {error.strerror}") from None

    def progress(self, stage: str = "uploading") -> Progress:
        fraction = self.done / self.total if self.total else 1.0
        return Progress(stage, fraction, "", self.done, self.total)

    def messages(self, request: Any, header: Any) -> Iterator[Any]:
        """request: the message class with header, file_start and chunk."""
        yield request(header=header)
        for file in self.files:
            with open(file.path, "rb") as stream:
                missing = os.fstat(stream.fileno()).st_size
                start = {"path": file.remote, "size_bytes": missing}
                yield request(file_start=start)
                while missing > 0:
                    chunk = stream.read(min(missing, CHUNK_BYTES))
                    if not chunk:
                        raise DataLossError(
                            f"{file.path}: became shorter while it was read"
                        )
                    missing -= len(chunk)
                    yield request(chunk=chunk)
                    self.done += len(chunk)
        self.complete = True


# --- what to import ------------------------------------------------------------

_IMAGES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm")

# The file that each format's tool writes, and the ends of the names of those
# with an image's features; what has none has them taken from the images.
_MODEL_FILES: Dict[MapFormat, Tuple[Tuple[str, ...], Tuple[str, ...]]] = {
    MapFormat.NVM: (("*.nvm",), (".sift",)),
    MapFormat.BUNDLER: (("bundle.out", "bundle/bundle.out"), (".key", ".key.gz")),
    MapFormat.OPENMVG: (("sfm_data.json",), (".feat", ".desc")),
    MapFormat.OPENSFM: (("reconstruction.json",), ()),
    MapFormat.GROUNDLOCK: (("*.glmap",), ()),
}
# Files beside the model, or among the images, that the format needs as well.
_LISTS = ("list.txt", "image_describer.json")
_TRACKS = "tracks*.csv"
_BY_SUFFIX = {".nvm": MapFormat.NVM, ".glmap": MapFormat.GROUNDLOCK}
_BY_NAME = {
    "bundle.out": MapFormat.BUNDLER,
    "sfm_data.json": MapFormat.OPENMVG,
    "reconstruction.json": MapFormat.OPENSFM,
}
_EXPECTED = (
    "expected a folder with a COLMAP model, or VisualSFM's .nvm, Bundler's "
    "bundle.out, OpenMVG's sfm_data.json, OpenSfM's reconstruction.json or a "
    ".glmap file"
)


def _colmap_folder(path: Path) -> Optional[Path]:
    """Where cameras, images and points3D are; sub-models: the largest."""
    for folder in (path, path / "sparse"):
        if _is_model(folder):
            return folder
        numbered = [
            f for f in folder.glob("[0-9]*") if f.name.isdigit() and _is_model(f)
        ]
        if numbered:
            return max(numbered, key=lambda f: sum(x.stat().st_size for x in f.iterdir()))
    return None


def _is_model(folder: Path) -> bool:
    return any(
        all((folder / f"{n}{e}").is_file() for n in ("cameras", "images", "points3D"))
        for e in (".bin", ".txt")
    )


def _colmap_files(
    path: Path, database: Optional[PathLike]
) -> Optional[ImportFiles]:
    folder = _colmap_folder(path)
    if folder is None:
        return None
    ending = ".bin" if (folder / "cameras.bin").is_file() else ".txt"
    names = ("cameras", "images", "points3D", "rigs", "frames")
    files = [
        LocalFile(folder / f"{n}{ending}", f"model/{n}{ending}")
        for n in names
        if (folder / f"{n}{ending}").is_file()
    ]
    found = Path(database) if database is not None else None
    if found is None:
        above = (folder, folder.parent, folder.parent.parent)
        found = next((f / "database.db" for f in above if (f / "database.db").is_file()), None)
    elif not found.is_file():
        raise NotFoundError(f"database: {found}: no such file", field="database")
    if found is not None:
        files.append(LocalFile(found, "database.db"))
    remote = "database.db" if found is not None else ""
    return ImportFiles(MapFormat.COLMAP, tuple(files), "model", remote)


def _model_file(path: Path, format: MapFormat) -> Tuple[MapFormat, Path]:
    if path.is_file():
        known = _BY_SUFFIX.get(path.suffix.lower(), _BY_NAME.get(path.name))
        return (known if format is MapFormat.AUTO else format) or format, path
    wanted = _MODEL_FILES if format is MapFormat.AUTO else {format: _MODEL_FILES[format]}
    for kind, (patterns, _) in wanted.items():
        for pattern in patterns:
            found = sorted(path.glob(pattern))
            if len(found) > 1:
                names = ", ".join(f.name for f in found)
                raise bad_argument("path", f"{path} holds {names}: name the one to import")
            if found:
                return kind, found[0]
    raise NotFoundError(f"path: {path}: no model here; {_EXPECTED}", field="path")


def find_import_files(
    path: PathLike,
    format: Union[MapFormat, str] = MapFormat.AUTO,
    database: Optional[PathLike] = None,
    images: Optional[PathLike] = None,
) -> ImportFiles:
    """From what a person names to the files of a reconstruction. The server
    reads them, and says what is wrong with them."""
    wanted = choice("format", format, MapFormat)
    root = Path(path)
    if not root.exists():
        raise NotFoundError(f"path: {root}: no such file or folder", field="path")
    if wanted in (MapFormat.AUTO, MapFormat.COLMAP) and root.is_dir():
        colmap = _colmap_files(root, database)
        if colmap is not None:
            return colmap
        if wanted is MapFormat.COLMAP:
            raise NotFoundError(
                f"path: {root}: no cameras, images and points3D files (.bin or .txt) "
                "here or in sparse/",
                field="path",
            )
    elif wanted is MapFormat.COLMAP:
        raise bad_argument("path", f"{root}: a COLMAP model is a folder")
    kind, model = _model_file(root, wanted)
    if kind is MapFormat.AUTO:
        raise bad_argument("path", f"{root}: {_EXPECTED}")
    if kind is MapFormat.GROUNDLOCK:
        return ImportFiles(kind, (LocalFile(model, model.name),), model.name)
    files = [LocalFile(model, model.name)]
    if kind is MapFormat.OPENSFM:
        files += [LocalFile(f, f.name) for f in sorted(model.parent.glob(_TRACKS))]
    folder = _images_folder(model, images)
    endings = _MODEL_FILES[kind][1]
    tree = [f for f in _tree(folder) if f != model]
    of_images = [f for f in tree if f.name.lower().endswith(endings)] if endings else []
    if not of_images:
        of_images = [f for f in tree if f.suffix.lower() in _IMAGES]
    of_images += [f for f in tree if f.name in _LISTS]
    for f in of_images:
        files.append(LocalFile(f, f"images/{f.relative_to(folder).as_posix()}"))
    remote = "images" if of_images else ""
    return ImportFiles(kind, tuple(files), model.name, images=remote)


def _images_folder(model: Path, images: Optional[PathLike]) -> Path:
    if images is not None:
        folder = Path(images)
        if not folder.is_dir():
            raise NotFoundError(f"images: {folder}: no such folder", field="images")
        return folder
    folder = model.parent.parent if model.parent.name == "bundle" else model.parent
    return folder / "images" if (folder / "images").is_dir() else folder


def _tree(folder: Path) -> List[Path]:
    return sorted(f for f in folder.rglob("*") if f.is_file())


def find_build_files(
    video: Optional[PathLike], images: Union[PathLike, Iterable[PathLike], None]
) -> Tuple[List[LocalFile], str]:
    """The files of a build, and the remote path of the video, if it is one."""
    if (video is None) == (images is None):
        raise bad_argument("video", "name either a video or images")
    if video is not None:
        path = Path(video)
        if not path.is_file():
            raise NotFoundError(f"video: {path}: no such file", field="video")
        return [LocalFile(path, path.name)], path.name
    assert images is not None
    if isinstance(images, (str, os.PathLike)):
        folder = Path(images)
        if not folder.is_dir():
            raise NotFoundError(f"images: {folder}: no such folder", field="images")
        photos = sorted(f for f in folder.iterdir() if f.suffix.lower() in _IMAGES)
        if not photos:
            raise NotFoundError(f"images: {folder}: holds no images", field="images")
    else:
        photos = sorted(Path(f) for f in images)
    return [LocalFile(f, f.name) for f in photos], ""


# --- exports --------------------------------------------------------------------


class ExportReceiver:
    """Writes what an export stream brings to a folder beside the target, and
    moves it there when it is whole. Use as a context manager."""

    def __init__(self, path: PathLike, format: Union[MapExportFormat, str]) -> None:
        self.format = choice("format", format, MapExportFormat)
        self.target = Path(path).absolute()
        if self.target.exists():
            raise AlreadyExistsError(f"path: {path}: exists", field="path")
        try:
            self._scratch = Path(
                tempfile.mkdtemp(prefix=".groundlock-", dir=self.target.parent)
            )
        except OSError as error:
            raise bad_argument("path", f"{path}: {error.strerror}") from None
        self._root = self._scratch / "export"
        self._root.mkdir()
        self._file: Any = None
        self._single: Optional[Path] = None
        self.done = 0
        self.total = 0
        self.warnings: List[str] = []

    def __enter__(self) -> ExportReceiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def progress(self) -> Progress:
        if self.total == 0:  # the server makes the files
            return Progress("preparing", 0.0)
        fraction = self.done / self.total
        return Progress("downloading", fraction, "", self.done, self.total)

    def take(self, message: Any) -> None:
        self.warnings.extend(message.warnings)
        kind = message.WhichOneof("message")
        try:
            if kind == "file_start":
                self._start(message.file_start)
            elif kind == "chunk":
                if self._file is None:
                    raise InternalError("the server sent bytes of no file")
                self._file.write(message.chunk)
                self.done += len(message.chunk)
        except OSError as error:
            raise ResourceExhaustedError(
                f"{self.target}: cannot be written: {error.strerror}"
            ) from None

    def _start(self, start: Any) -> None:
        relative = PurePosixPath(start.path)
        if relative.is_absolute() or ".." in relative.parts:
            raise InternalError(
                f"the server sent a file outside of the export: {start.path}"
            )
        self._close()
        path = self._root / relative
        if not start.path:
            path = self._single = self._scratch / "single"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "wb")
        self.total += start.size_bytes

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def place(self) -> None:
        """Moves what has arrived to its place."""
        self._close()
        if self.done != self.total:
            raise DataLossError("the server sent less than it announced")
        try:
            if self._single is not None:
                self._single.rename(self.target)
            elif self.format is MapExportFormat.NVM:
                self._place_nvm()
            else:
                self._root.rename(self.target)
                self.target.chmod(0o755)
        except OSError as error:
            raise FailedPreconditionError(
                f"{self.target}: cannot be created: {error.strerror}"
            ) from None

    def _place_nvm(self) -> None:
        """The model under the name that was asked for, its features beside."""
        moves = {
            f: self.target if f.suffix == ".nvm" else self.target.parent / f.name
            for f in self._root.iterdir()
        }
        for target in moves.values():
            if target.exists():
                raise AlreadyExistsError(f"{target}: exists")
        for source, target in moves.items():
            source.rename(target)
