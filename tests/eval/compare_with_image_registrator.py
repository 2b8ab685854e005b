#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Localises held-out images with Groundlock and with COLMAP, in one map.

strecha  Herz-Jesus-P25: a map from the images with an even number and their
         true poses (features, matches and triangulation by COLMAP), the images
         with an odd number against it; errors against the laser-scanned truth.
plaza    the map that lies there, every tenth frame of another flight (those
         with a reference pose); errors against that, in units of the map.

COLMAP's side is feature_extractor, matches_importer and image_registrator,
its time that of all three per image. For plaza it is told the ten views of the
map that are nearest to the truth, which saves it a search; in strecha it matches
all views. Times are processor times of all threads, so that other load on the
machine does not matter much; COLMAP's loading of the map is left out by running
image_registrator once without new images.

Needs `colmap` and, for plaza, `ffmpeg`; Python's standard library alone.

  tests/eval/compare_with_image_registrator.py strecha|plaza [--work DIR]
      [--program build/bin/localize_images] [--data ../shared/data]
"""
import argparse
import array
import collections
import csv
import itertools
import json
import math
import os
import pathlib
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile

THREADS = "2"


def run(*command, quiet=True):
  """Runs a command; returns its processor time in seconds and its output."""
  before = resource.getrusage(resource.RUSAGE_CHILDREN)
  done = subprocess.run([str(part) for part in command],
                        stdout=subprocess.PIPE,
                        stderr=subprocess.PIPE,
                        text=True)
  after = resource.getrusage(resource.RUSAGE_CHILDREN)
  if done.returncode != 0:
    sys.exit(f"{command[0]} {command[1]} failed:\n{done.stdout}{done.stderr}")
  seconds = (after.ru_utime - before.ru_utime) + (after.ru_stime -
                                                  before.ru_stime)
  return seconds, done.stdout


def multiply(a, b):
  """Product of quaternions w, x, y, z."""
  return (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
          a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
          a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])


def conjugate(q):
  return (q[0], -q[1], -q[2], -q[3])


def rotate(q, v):
  return multiply(multiply(q, (0.0, *v)), conjugate(q))[1:]


def angle_deg(a, b):
  q = multiply(conjugate(a), b)
  sine = math.sqrt(sum(x * x for x in q[1:]))
  return math.degrees(2.0 * math.atan2(sine, abs(q[0])))


def invert(q, t):
  """(q, centre) for camera_from_world (q, t), and the other way round."""
  back = conjugate(q)
  return back, tuple(-x for x in rotate(back, t))


def read_images_txt(path):
  """world_from_camera by name: (q, centre)."""
  poses = {}
  lines = [line for line in path.read_text().splitlines()
           if not line.startswith("#")]
  for line in lines[::2]:
    cells = line.split(maxsplit=9)
    if len(cells) == 10:
      q = tuple(float(x) for x in cells[1:5])
      t = tuple(float(x) for x in cells[5:8])
      poses[cells[9]] = invert(q, t)
  return poses


def write_tracks_as_matches(images_txt, database):
  """The matches among a model's views that its tracks are made of.

  image_registrator gives up where the database has none of a view.
  """
  lines = [line for line in images_txt.read_text().splitlines()
           if not line.startswith("#")]
  tracks = collections.defaultdict(list)
  for pose, points in zip(lines[::2], lines[1::2]):
    image = int(pose.split(maxsplit=1)[0])
    for index, point in enumerate(points.split()[2::3]):
      if point != "-1":
        tracks[point].append((image, index))
  matches = collections.defaultdict(list)
  for track in tracks.values():
    for (a, i), (b, j) in itertools.combinations(sorted(track), 2):
      if a != b:
        matches[a, b].append((i, j))
  calibrated = 2
  with sqlite3.connect(database) as connection:
    for (a, b), pairs in matches.items():
      indices = array.array("I", itertools.chain.from_iterable(pairs))
      connection.execute(
          "INSERT INTO two_view_geometries (pair_id, rows, cols, data, config)"
          " VALUES (?, ?, 2, ?, ?)",
          (2147483647 * a + b, len(pairs), indices.tobytes(), calibrated))


def poses_of_model(model, text):
  text.mkdir()
  run("colmap", "model_converter", "--input_path", model, "--output_path", text,
      "--output_type", "TXT")
  return read_images_txt(text / "images.txt")


class Strecha:
  """Images with known poses: the map is made here."""
  unit = "m"

  def __init__(self, data, work):
    folder = data / "strecha" / "herz-jesus-p25"
    self.images = folder / "images"
    cameras = json.loads((folder / "cameras.json").read_text())
    first = cameras[0]
    self.camera = {key: first[key]
                   for key in ("width", "height", "model", "params")}
    self.truth = {c["image"]: (tuple(c["world_from_camera_wxyz"]),
                               tuple(c["centre_m"])) for c in cameras}
    names = sorted(self.truth)
    self.mapped, self.queries = names[0::2], names[1::2]
    self.database = work / "database.db"
    self.map = work / "map"
    self.build(work)

  def build(self, work):
    (work / "mapped.txt").write_text("\n".join(self.mapped) + "\n")
    run("colmap", "feature_extractor", "--database_path", self.database,
        "--image_path", self.images, "--image_list_path", work / "mapped.txt",
        "--ImageReader.single_camera", "1", "--ImageReader.camera_model",
        self.camera["model"], "--ImageReader.camera_params",
        ",".join(map(str, self.camera["params"])), "--SiftExtraction.use_gpu",
        "0", "--SiftExtraction.num_threads", THREADS)
    run("colmap", "exhaustive_matcher", "--database_path", self.database,
        "--SiftMatching.use_gpu", "0", "--SiftMatching.num_threads", THREADS)
    known = work / "known"
    known.mkdir()
    with sqlite3.connect(self.database) as database:
      ids = dict(database.execute("SELECT name, image_id FROM images"))
    camera = self.camera
    (known / "cameras.txt").write_text(
        f"1 {camera['model']} {camera['width']} {camera['height']} " +
        " ".join(map(str, camera["params"])) + "\n")
    lines = []
    for name in self.mapped:
      q, t = invert(*self.truth[name])
      lines.append(" ".join(map(str, (ids[name], *q, *t, 1, name))) + "\n\n")
    (known / "images.txt").write_text("".join(lines))
    (known / "points3D.txt").write_text("")
    self.map.mkdir()
    run("colmap", "point_triangulator", "--database_path", self.database,
        "--image_path", self.images, "--input_path", known, "--output_path",
        self.map)

  def pairs(self, name):
    return self.mapped


class Plaza:
  """A map that is there, and frames of another flight."""
  unit = "units"

  def __init__(self, data, work):
    folder = data / "plaza"
    self.camera = json.loads((folder / "camera.json").read_text())
    self.images = work / "images"
    self.images.mkdir()
    run("ffmpeg", "-loglevel", "error", "-i", folder / "person12.mp4", "-vf",
        r"select=not(mod(n\,10))", "-vsync", "0", "-start_number", "0", "-q:v",
        "2", self.images / "%04d.jpg")
    self.truth = {}
    with open(folder / "person12_reference.csv", encoding="ascii") as file:
      for row in csv.DictReader(file):
        frame = int(row["frame"])
        if frame % 10 == 0:
          self.truth[f"{frame // 10:04d}.jpg"] = (
              tuple(float(row[f"q_{axis}"]) for axis in "wxyz"),
              tuple(float(row[f"cam_{axis}"]) for axis in "xyz"))
    self.queries = sorted(name for name in self.truth
                          if (self.images / name).exists())
    self.database = work / "database.db"
    shutil.copy(folder / "map" / "database.db", self.database)
    self.map = folder / "map" / "sparse" / "0"
    self.views = poses_of_model(self.map, work / "map_text")
    write_tracks_as_matches(work / "map_text" / "images.txt", self.database)

  def pairs(self, name):
    q, centre = self.truth[name]
    def cost(view):
      other_q, other = self.views[view]
      return math.dist(centre, other) * (1 + angle_deg(q, other_q) / 20)
    return sorted(self.views, key=cost)[:10]


def with_colmap(place, work):
  """Poses by name, and processor seconds per image by stage."""
  database = work / "colmap.db"
  shutil.copy(place.database, database)
  with sqlite3.connect(database) as connection:
    camera_id = connection.execute(
        "SELECT camera_id FROM images LIMIT 1").fetchone()[0]
  queries = work / "queries.txt"
  queries.write_text("\n".join(place.queries) + "\n")
  stages = {}
  stages["features"], _ = run(
      "colmap", "feature_extractor", "--database_path", database,
      "--image_path", place.images, "--image_list_path", queries,
      "--ImageReader.existing_camera_id", camera_id, "--SiftExtraction.use_gpu",
      "0", "--SiftExtraction.num_threads", THREADS)
  pairs = work / "pairs.txt"
  pairs.write_text("".join(f"{name} {view}\n" for name in place.queries
                           for view in place.pairs(name)))
  stages["matching"], _ = run(
      "colmap", "matches_importer", "--database_path", database,
      "--match_list_path", pairs, "--match_type", "pairs",
      "--SiftMatching.use_gpu", "0", "--SiftMatching.num_threads", THREADS)
  register = lambda base, out: run(
      "colmap", "image_registrator", "--database_path", base, "--input_path",
      place.map, "--output_path", out)[0]
  (work / "nothing").mkdir()
  (work / "registered").mkdir()
  empty = register(place.database, work / "nothing")
  stages["registration"] = max(0.0,
                               register(database, work / "registered") - empty)
  poses = poses_of_model(work / "registered", work / "registered_text")
  count = len(place.queries)
  return ({name: poses[name] for name in place.queries if name in poses},
          {name: seconds / count for name, seconds in stages.items()})


def with_groundlock(place, program, work):
  """Poses by name, and processor and wall seconds per image."""
  model = work / "model"
  model.mkdir()
  for file in pathlib.Path(place.map).iterdir():
    if file.suffix in (".bin", ".txt"):
      shutil.copy(file, model)
  shutil.copy(place.database, model / "database.db")
  camera = work / "camera.json"
  camera.write_text(json.dumps(place.camera))
  _, out = run(program, model, camera,
               *(place.images / name for name in place.queries))
  poses, cpu, wall = {}, [], []
  for row in csv.DictReader(out.splitlines()):
    cpu.append(float(row["cpu_ms"]) / 1e3)
    wall.append(float(row["ms"]) / 1e3)
    if row["tracked"] == "1":
      poses[os.path.basename(row["image"])] = (
          tuple(float(row[key]) for key in ("qw", "qx", "qy", "qz")),
          tuple(float(row[key]) for key in "xyz"))
  return poses, median(cpu), median(wall)


def median(values):
  ordered = sorted(values)
  return ordered[len(ordered) // 2] if ordered else float("nan")


def errors(place, poses):
  centre = [math.dist(poses[n][1], place.truth[n][1]) for n in poses]
  angle = [angle_deg(poses[n][0], place.truth[n][0]) for n in poses]
  return centre, angle


def main():
  parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
  parser.add_argument("place", choices=("strecha", "plaza"))
  parser.add_argument("--program", default="build/bin/localize_images")
  parser.add_argument("--data", default=os.environ.get("GROUNDLOCK_DATA",
                                                       "../shared/data"))
  parser.add_argument("--work", help="folder to keep, for a look at what was "
                      "made; must not exist")
  arguments = parser.parse_args()
  temporary = None
  if arguments.work:
    work = pathlib.Path(arguments.work)
    work.mkdir()
  else:
    temporary = tempfile.TemporaryDirectory()
    work = pathlib.Path(temporary.name)
  data = pathlib.Path(arguments.data).resolve()
  place = (Strecha if arguments.place == "strecha" else Plaza)(data, work)
  program = pathlib.Path(arguments.program).resolve()
  ours, cpu, wall = with_groundlock(place, program, work)
  theirs, stages = with_colmap(place, work)

  print(f"{arguments.place}: {len(place.queries)} images held out")
  print(f"{'':22}{'groundlock':>14}{'image_registrator':>20}")
  print(f"{'localised':22}{len(ours):14d}{len(theirs):20d}")
  rows = []
  for poses in (ours, theirs):
    centre, angle = errors(place, poses)
    rows.append((median(centre), max(centre, default=float("nan")),
                 median(angle), max(angle, default=float("nan"))))
  for i, label in enumerate((f"centre median, {place.unit}",
                             f"centre max, {place.unit}", "angle median, deg",
                             "angle max, deg")):
    print(f"{label:22}{rows[0][i]:14.5f}{rows[1][i]:20.5f}")
  total = sum(stages.values())
  print(f"{'CPU per image, s':22}{cpu:14.3f}{total:20.3f}   (" + ", ".join(
      f"{name} {seconds:.3f}" for name, seconds in stages.items()) + ")")
  print(f"{'wall clock, s':22}{wall:14.3f}")
  print(f"image_registrator : groundlock, CPU per image  {total / cpu:.1f}")
  if temporary:
    temporary.cleanup()


if __name__ == "__main__":
  main()
