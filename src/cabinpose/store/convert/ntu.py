"""NTU RGB+D skeletons (Shahroudy et al. 2016; Liu et al. 2019): text files of the 25 joints of Kinect v2, one a clip.

A file is the number of frames; a frame the number of bodies; a body a line of 10 fields (bodyID, clippedEdges, confidence and
state of both hands, isRestricted, lean x y, trackingState), the number of joints, and a line of 12 fields for each joint: x y z
(m), depthX depthY, colorX colorY (px), orientation w x y z, trackingState (0 not tracked, 1 inferred, 2 tracked). The name
SsssCcccPpppRrrrAaaa is setup, camera, performer, repetition and action.

Kinect v2's camera space is right-handed with x to the sensor's left, y up and z forward (Kinect SDK 2.0, "Coordinate
mapping"): ours (x right, y down, z forward) is that turned by half a turn about z, (x, y, z) -> (-x, -y, z). Its images are
mirrored, so that depthX grows with its x: column u of an unmirrored image, which is what our axes go with, is 511 - depthX.
To flip y alone would make right-handed people left-handed.

Beside the skeletons there are depth maps, a folder a clip with MDepth-00000001.png and so on (masked: the people and what is near
them) or Depth-00000001.png: 512x424, 16 bits, mm, 0 = invalid, mirrored like all images of Kinect v2.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, LENGTHS_M, NTU_JOINTS, Camera, DatasetError, Visibility
from cabinpose.store.convert.format import DatasetFormat, NoOptions
from cabinpose.store.convert.reading import (
    Origin,
    SequenceOptions,
    check_projection,
    given_camera,
    make_manifest,
    put_camera,
    put_person,
    read_grey,
)  # fmt: skip
from cabinpose.store.frames import PersonInFrame, frames, people
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import Report, Source, blank_frame

if TYPE_CHECKING:
    import xarray as xr

# Nominal intrinsics of Kinect v2's depth camera: one device's factory calibration, published with OpenKinect for Processing and
# much used for others, whose differ by a few pixels. The files carry none. cx is counted in the unmirrored image.
KINECT_V2 = Camera(512, 424, 365.456, 365.456, 511 - 254.878, 205.395, (0.0905474, -0.26819, 0.0, 0.0, 0.0950862))
FRAME_NS = 1e9 / 30
_TURN = np.array([-1.0, -1.0, 1.0])  # Kinect's camera space to ours, and back
_OURS, _THEIRS = CABINPOSE.counterparts("kinect_v2", NTU_JOINTS)
_STATES = np.array([Visibility.ABSENT, Visibility.OCCLUDED, Visibility.VISIBLE], np.uint8)  # by trackingState
_TRACKING = {Visibility.ABSENT: 0, Visibility.VISIBLE: 2}  # by our state; 1 for the others: known, but not seen
_NAME = re.compile(r"(S\d{3})(C\d{3})(P\d{3})R\d{3}(A\d{3})")
_BODY_LINES = 2 + len(NTU_JOINTS)
_HINT = "the file may be cut short, or be no skeleton file of NTU RGB+D; copy it again"


@dataclass(frozen=True, kw_only=True)
class NtuImport(SequenceOptions):
    """How skeletons of NTU RGB+D are read."""

    images: Path | None = None
    """Folder of the clips' depth maps; default: that of the skeletons, else joints only."""


class NtuFormat(DatasetFormat):
    """Skeletons of NTU RGB+D; depth maps are read too."""

    import_options = NtuImport

    def read(self, path: Path, options: NtuImport) -> Source:
        """The frames of a `.skeleton` file, or of all in a folder by name, one `sequence` a file.

        Depth maps are in folders of the clips' names in `options.images`, or beside the files; where there are none, there are
        joints only. A person keeps one place for as long as the body is tracked. All bodies have the performer of the file's
        name as `subject`: it does not say who the second one is. Raises `DatasetError` for a file that is damaged or named
        otherwise, and where some of the depth maps are missing.
        """
        stems = {file.stem: file for file in (sorted(path.glob("*.skeleton")) if path.is_dir() else [path])}
        if not stems:
            raise DatasetError(f"{path} holds no .skeleton file", hint="give a file, or the folder that has them")
        files = [stems[stem] for stem in options.chosen(path, list(stems))]
        for file in files:
            if _NAME.fullmatch(file.stem) is None:
                raise DatasetError(f"{file.name} is no name of NTU RGB+D", hint="name it as S001C002P003R001A013.skeleton")
        counts = [_count(file) for file in files]
        bodies = max(1, *(most for _, most in counts))
        camera = given_camera(options, (KINECT_V2.width, KINECT_V2.height)) or KINECT_V2
        maps = _maps(files, options.images)
        manifest = make_manifest(
            Origin("ntu", path, options),
            frames=sum(-(-count // options.every) for count, _ in counts),
            size=(camera.width, camera.height),
            persons=tuple(f"person_{i + 1}" for i in range(bodies)),
            variables=("depth",) if maps else (),
        )

        def all_frames() -> Iterator[dict[str, Any]]:
            for sequence, file in enumerate(files):
                clip = _frames(file, sequence, camera, manifest)
                for index, frame in islice(enumerate(clip), 0, None, options.every):
                    if maps:
                        frame["depth"] = _depth_map(maps[sequence], index)
                    yield frame

        return Source(path, manifest, all_frames)

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, _: NoOptions, report: Report) -> None:
        """Write every clip into `folder`, and `names.json`, which says what the numbers of the names stand for.

        depthX and depthY are where a Kinect v2 in the camera's place would see a joint; colour pixels and orientations are 0, as
        are joints that are absent or that ours do not have. Raises `DatasetError` for what the names have no room for.
        """
        (dataset,) = parts.values()
        clips = _clips(dataset)
        stems, names = _file_names(clips)
        (folder / "names.json").write_text(json.dumps(names, indent=1, ensure_ascii=False), encoding="utf-8")
        rest, done = frames(dataset, ()), 0
        for clip, stem in zip(clips, stems, strict=True):
            with (folder / f"{stem}.skeleton").open("w", encoding="ascii") as file:
                file.write(f"{clip.frames}\n")
                for frame in islice(rest, clip.frames):
                    persons = people(frame)
                    file.write(f"{len(persons)}\n")
                    file.writelines(map(_body_text, persons))
                    done += 1
                    report(done)


NTU = NtuFormat()


# ---------------------------------------------------------------------------------------------------------- reading


def _maps(files: list[Path], folder: Path | None) -> list[Path]:
    """The start of the paths of each clip's depth maps; none where no clip has a folder of them."""
    folders = [(folder or file.parent) / file.stem for file in files]
    there = [each.is_dir() for each in folders]
    if not any(there) and folder is None:
        return []
    if not all(there):
        lacking = folders[there.index(False)]
        raise DatasetError(
            f"{lacking} does not exist", hint="depth maps are in a folder a clip; leave clips out with --sequences"
        )
    return [each / ("MDepth" if any(each.glob("MDepth-*.png")) else "Depth") for each in folders]


def _depth_map(start: Path, index: int) -> NDArray[np.uint16]:
    """Ticks of depth (424, 512) of a clip's frame, in the unmirrored image."""
    path = start.with_name(f"{start.name}-{index + 1:08d}.png")
    return ticks_of_steps(read_grey(path, np.uint16, (KINECT_V2.width, KINECT_V2.height))[:, ::-1], LENGTHS_M["mm"])


class _Lines:
    """Reads a file line by line; errors name the line."""

    def __init__(self, path: Path, file: TextIO) -> None:
        self._path, self._file, self._number = path, file, 0

    def fields(self, count: int) -> list[str]:
        """The next line's fields, of which there have to be `count`."""
        self._number += 1
        line = self._file.readline()
        words = line.split()
        if len(words) != count:
            raise self.error(f"{len(words)} fields where {count} belong" if line else "the file ends too early")
        return words

    def number(self) -> int:
        """The next line as a number of things."""
        (word,) = self.fields(1)
        if not word.isdecimal():
            raise self.error(f"'{word}' is no number of things")
        return int(word)

    def skip(self, count: int) -> None:
        """Go on by `count` lines, which have to be there."""
        found = sum(1 for _ in islice(self._file, count))
        self._number += found
        if found < count:
            self._number += 1
            raise self.error("the file ends too early")

    def end(self) -> None:
        """Nothing but blank lines may follow."""
        for line in self._file:
            self._number += 1
            if line.strip():
                raise self.error("there is more than the frames that it says")

    def error(self, what: str) -> DatasetError:
        return DatasetError(f"{self._path}:{self._number}: {what}", hint=_HINT)


def _opened(path: Path) -> TextIO:
    try:
        return path.open(encoding="ascii", errors="replace")
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}", hint="check the file and its permissions") from error


def _count(path: Path) -> tuple[int, int]:
    """(frames, most bodies in one of them) of a file, which is seen to be whole."""
    with _opened(path) as file:
        lines = _Lines(path, file)
        count, most = lines.number(), 0
        for _ in range(count):
            bodies = lines.number()
            lines.skip(bodies * _BODY_LINES)
            most = max(most, bodies)
        lines.end()
    return count, most


class _Body(NamedTuple):
    """A body: its bodyID, (25, 3) m and (25, 2) px as in the file, (25,) trackingState."""

    who: str
    xyz: NDArray[np.float64]
    depth_uv: NDArray[np.float64]
    tracking: NDArray[np.int64]


def _body(lines: _Lines) -> _Body:
    who = lines.fields(10)[0]
    if lines.number() != len(NTU_JOINTS):
        raise lines.error(f"a body has {len(NTU_JOINTS)} joints")
    try:
        values = np.array([lines.fields(12) for _ in NTU_JOINTS], np.float64)
    except ValueError as error:
        raise lines.error(f"up to here, a body has something that is no number ({error})") from error
    if not np.isin(values[:, 11], (0, 1, 2)).all():
        raise lines.error("up to here, a body has a trackingState other than 0, 1 and 2")
    return _Body(who, values[:, :3], values[:, 3:5], values[:, 11].astype(np.int64))


def _frames(path: Path, sequence: int, camera: Camera, manifest: Manifest) -> Iterator[dict[str, Any]]:
    match = _NAME.fullmatch(path.stem)
    setup, view, performer, action = match.groups() if match is not None else ("", "", "", "")
    places: dict[str, int] = {}
    checked = False
    with _opened(path) as file:
        lines = _Lines(path, file)
        for index in range(lines.number()):
            bodies = [_body(lines) for _ in range(lines.number())]
            if bodies and not checked:
                _check_camera(bodies, camera, path)
                checked = True
            positions = _positions([body.who for body in bodies], places)
            places = {body.who: position for body, position in zip(bodies, positions, strict=True)}
            frame = blank_frame(manifest)
            frame["sequence"], frame["sync_ns"] = np.int64(sequence), np.int64(round(index * FRAME_NS))
            frame["car"], frame["pov"] = setup, view
            put_camera(frame, camera)
            for body, position in zip(bodies, positions, strict=True):
                frame["subject"][position], frame["action"][position] = performer, action
                put_person(frame, position, camera, _OURS, body.xyz[_THEIRS] * _TURN, _STATES[body.tracking[_THEIRS]])
            yield frame


def _positions(bodies: list[str], before: dict[str, int]) -> list[int]:
    """The place of each body: the one that it had in the frame before, else the first that is free."""
    result = [-1] * len(bodies)
    for i, who in enumerate(bodies):
        if who in before and before[who] not in result:
            result[i] = before[who]
    for i, place in enumerate(result):
        if place < 0:
            result[i] = next(free for free in range(len(bodies) + len(before)) if free not in result)
    return result


def _check_camera(bodies: list[_Body], camera: Camera, path: Path) -> None:
    """The file's pixels have to be where the camera sees the tracked joints; files whose pixels are all 0 have none."""
    tracked = [body.tracking == 2 for body in bodies]
    xyz = np.concatenate([body.xyz[seen] for body, seen in zip(bodies, tracked, strict=True)])
    given = np.concatenate([body.depth_uv[seen] for body, seen in zip(bodies, tracked, strict=True)])
    if not given.any():
        return
    uv = camera.project(xyz * _TURN)
    mirrored = np.stack((camera.width - 1 - uv[:, 0], uv[:, 1]), axis=-1)
    hint = "x, y and z are metres in Kinect's camera space, y up; for another camera give --intrinsics"
    check_projection(path, ("depthX and depthY", "x, y and z"), mirrored, given, hint=hint)


# ---------------------------------------------------------------------------------------------------------- writing


@dataclass
class _Clip:
    """Frames in a row that become one file: of one sequence, place and view, whose first person stays and does one thing."""

    sequence: int
    car: str
    pov: str
    who: tuple[str, str] | None  # subject and action
    frames: int = 1


def _clips(dataset: xr.Dataset) -> list[_Clip]:
    clips: list[_Clip] = []
    columns = (dataset[name].values for name in ("sequence", "car", "pov", "subject", "action"))
    for sequence, car, pov, subjects, actions in zip(*columns, strict=True):
        who = next(((str(s), str(a)) for s, a in zip(subjects, actions, strict=True) if s), None)
        last = clips[-1] if clips else None
        if last is None or (last.sequence, last.car, last.pov) != (sequence, car, pov) or (who and last.who and who != last.who):
            clips.append(_Clip(int(sequence), str(car), str(pov), who))
        else:
            last.frames += 1
            last.who = last.who or who
    return clips


def _file_names(clips: list[_Clip]) -> tuple[list[str], dict[str, dict[str, str]]]:
    """A name for each clip, and what the letters' numbers stand for; 000 for nobody and for the action of nobody."""
    values = {
        "S": [clip.car for clip in clips],
        "C": [clip.pov for clip in clips],
        "P": [clip.who[0] if clip.who else "" for clip in clips],
        "A": [clip.who[1] if clip.who else "" for clip in clips],
    }
    codes = {letter: {v: f"{letter}{i:03d}" for i, v in enumerate(sorted(set(v) - {""}), 1)} for letter, v in values.items()}
    seen: Counter[tuple[str, ...]] = Counter()
    stems = []
    for row in zip(*values.values(), strict=True):
        s, c, p, a = (codes[letter].get(value, f"{letter}000") for letter, value in zip(values, row, strict=True))
        seen[s, c, p, a] += 1
        stems.append(f"{s}{c}{p}R{seen[s, c, p, a]:03d}{a}")
    for stem in stems:
        if _NAME.fullmatch(stem) is None:
            raise DatasetError(
                f"names of NTU RGB+D count to 999, and {stem} goes beyond", hint="export a split of fewer people or clips"
            )
    return stems, {letter: {code: value for value, code in table.items()} for letter, table in codes.items()}


def _body_text(person: PersonInFrame) -> str:
    """The lines of one body. Numbers have the digits that give the same float32 again."""
    tracking = np.zeros(len(NTU_JOINTS), np.int64)
    xyz, uv = np.zeros((len(NTU_JOINTS), 3), np.float32), np.zeros((len(NTU_JOINTS), 2), np.float32)
    joints = person.joints_3d[_OURS]
    known = np.asarray(np.isfinite(joints).all(axis=1))
    tracking[_THEIRS] = [_TRACKING.get(Visibility(state), 1) for state in person.visibility[_OURS]] * known
    xyz[_THEIRS] = np.where(known[:, None], joints * _TURN, 0)
    pixels = KINECT_V2.project(joints)
    uv[_THEIRS] = np.nan_to_num(np.stack((KINECT_V2.width - 1 - pixels[:, 0], pixels[:, 1]), axis=-1))
    lines = [f"{person.position + 1} 0 0 0 0 0 0 0 0 2", str(len(NTU_JOINTS))]
    for position, pixel, state in zip(xyz, uv, tracking.tolist(), strict=True):
        numbers = " ".join(str(value) for value in (*position, *pixel))
        lines.append(f"{numbers} 0 0 0 0 0 0 {state}")
    return "\n".join(lines) + "\n"
