"""A detector's answers on a dataset: the predictions file, which any tool can write.

Two encodings of one table, a row for each joint found: JSON lines (`.jsonl`), or Parquet (`.parquet`, with the extra `parquet`).
Columns: `frame` (number in the dataset), `person` (slot), `joint` (name), `u`, `v` (px, or null), `x`, `y`, `z` (m, camera frame;
all three, or null), `score`, `presence` (0..1), `expected_error_m` (m, or null). A frame in which nobody can be seen has one row
of `frame` and `reason`, behind all joints. The header holds `format`, `version`, `model`, `skeleton`, `joints`, `persons`, and,
where the writer knows them, `dataset`, `remarks`, `trained_on`, the frames that the model was trained on ("0-84 90"), and
`joint_definition`, "anatomy" where joints lie as docs/joints.md has them, "plug_in_gait" where as Plug-in Gait.
In JSON lines the header is the first line and `{"rows": n}` the last, so that a file cut short is noticed; in Parquet the header
is the value of the key `cabinpose` of the file's metadata.

A joint without a row was not found: what the file leaves out counts as missed, a whole frame too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import POSE_ARRAYS, DependencyError, PoseBatch, PredictionsError, check_claim, whole_file
from cabinpose.store.named_poses import NamedPoses
from cabinpose.store.split import in_ranges

FORMAT: Final = "cabinpose-predictions"
VERSION: Final = 1
_NUMBERS = ("u", "v", "x", "y", "z", "score", "presence", "expected_error_m")
COLUMNS = ("frame", "person", "joint", *_NUMBERS, "reason")
_WHERE_KNOWN = ("remarks", "trained_on", "joint_definition")
_HEADER_KEYS = ("format", "version", "model", "skeleton", "joints", "persons", "dataset", *_WHERE_KNOWN)
_PARQUET_KEY = b"cabinpose"
_ROW_BYTES = 8 * len(COLUMNS)  # of a table in memory
_PROBABILITY = "give a number from 0 to 1: per cent divided by 100, a logit through the logistic function"
_FILLERS = (0.0, -1.0)  # what tools write for a position that they do not have
_MOST_FILLED = 2  # in the image; a corner's centre is a position as well. In space it is the lens, or behind it
_DESCRIBED = "docs/evaluation.md describes the format"


@dataclass(frozen=True, repr=False)
class Predictions(NamedPoses):
    """The answers of one model: `PoseBatch`'s arrays over the frames numbered `frame` (F,) int64, in rising order.

    persons: (P,) slots · joints: (J,) names · dataset: id or folder name of the dataset, where the writer knew it · trained_on:
    ranges of the dataset's frames that the model was trained on, as `frame_ranges` writes them, as far as it is known ·
    joint_definition: of `core.JOINT_DEFINITIONS`, or "" where the joints are taken to be placed as the dataset's are.
    """

    frame: NDArray[np.int64]
    persons: tuple[str, ...]
    joints: tuple[str, ...]
    model: str
    skeleton: str = "cabinpose"
    dataset: str | None = None
    trained_on: str = ""
    joint_definition: str = ""

    @property
    def numbers(self) -> NDArray[np.int64]:
        """(F,) the numbers of the frames."""
        return self.frame

    def take(self, frames: NDArray[np.int64]) -> PoseBatch:
        """The answers on the frames with the given numbers, in that order; frames without an answer are empty."""
        at = np.minimum(np.searchsorted(self.frame, frames), max(len(self.frame) - 1, 0))
        known = self.frame[at] == frames if len(self.frame) else np.zeros(len(frames), bool)
        batch = empty_batch(len(frames), len(self.persons), len(self.joints))
        for name in POSE_ARRAYS:
            getattr(batch, name)[known] = getattr(self, name)[at[known]]
        batch.reason[known] = self.reason[at[known]]
        return batch


def empty_batch(frames: int, persons: int, joints: int) -> PoseBatch:
    """A batch in which nothing was found."""
    shape = (frames, persons, joints)
    return PoseBatch(
        np.full((*shape, 2), np.nan, np.float32),
        np.full((*shape, 3), np.nan, np.float32),
        np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
    )


def check_new_predictions(file: Path, *, overwrite: bool) -> None:
    """Raise `PredictionsError` unless a predictions file may be written under this name.

    Raises DependencyError where what writes it is not installed.
    """
    if file.suffix not in (".jsonl", ".parquet"):
        raise PredictionsError(f"{file.name} is no name of a predictions file", hint="let it end in .jsonl or .parquet")
    if file.exists() and not overwrite:
        raise PredictionsError(f"{file} exists", hint="--overwrite replaces it, or give another name")
    if file.suffix == ".parquet":
        _need_pyarrow()


def write_predictions(path: Path | str, predictions: Predictions, *, overwrite: bool = False) -> Path:
    """Write a predictions file; it appears when it is whole.

    A joint gets a row if its position (in px or m) is finite, and a frame if there is a reason why nobody can be seen in it.

    Parameters
    ----------
    path
        The file: Parquet where its name ends in `.parquet`, JSON lines where it ends in `.jsonl`.
    predictions
        What to write.
    overwrite
        Replace the file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    PredictionsError
        Where the file exists, or its name ends otherwise.
    """
    file = Path(path)
    check_new_predictions(file, overwrite=overwrite)
    header = {"format": FORMAT, "version": VERSION} | {
        name: getattr(predictions, name) for name in _HEADER_KEYS[2 : -len(_WHERE_KNOWN)]
    }
    header |= {name: value for name in _WHERE_KNOWN if (value := getattr(predictions, name))}
    with whole_file(file, kind=PredictionsError) as partial:
        if file.suffix == ".parquet":
            _write_parquet(partial, header, predictions)
        else:
            _write_lines(partial, header, predictions)
    return file


def read_predictions(path: Path | str) -> Predictions:
    """Read a predictions file; `PredictionsError` names the row of what is wrong with it and what to do."""
    file = Path(path)
    try:
        columns, header = _read_parquet(file) if file.suffix == ".parquet" else _read_lines(file)
    except FileNotFoundError:
        raise PredictionsError(
            f"there is no predictions file {file}", hint="give the path of a .jsonl or .parquet file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise PredictionsError(f"cannot read {file}: {error}", hint="check the file and its permissions") from error
    return _dense(file, columns, header)


# ------------------------------------------------------------------------------------------------------- JSON lines


def _write_lines(path: Path, header: Mapping[str, Any], predictions: Predictions) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.write(json.dumps(header) + "\n")
        count = 0
        for row in _rows(predictions):
            file.write(json.dumps(row, allow_nan=False) + "\n")
            count += 1
        file.write(json.dumps({"rows": count}) + "\n")


def _rows(predictions: Predictions) -> Iterator[dict[str, Any]]:
    for f, p, j in zip(*_found(predictions), strict=True):
        row: dict[str, Any] = {
            "frame": int(predictions.frame[f]), "person": predictions.persons[p], "joint": predictions.joints[j],
        }  # fmt: skip
        for names, values in (("uv", predictions.joints_2d[f, p, j]), ("xyz", predictions.joints_3d[f, p, j])):
            if np.isfinite(values).all():  # str(float32) is its shortest decimal: it reads back as the same float32
                row |= {name: float(str(value)) for name, value in zip(names, values, strict=True)}
        for name in ("score", "presence", "expected_error_m"):
            if np.isfinite(value := getattr(predictions, name)[f, p, j]):
                row[name] = float(str(value))
        yield row
    for frame, reason in zip(predictions.frame, predictions.reason, strict=True):
        if reason:
            yield {"frame": int(frame), "reason": str(reason)}


def _found(predictions: Predictions) -> tuple[NDArray[np.int64], ...]:
    finite = np.isfinite(predictions.joints_2d).all(axis=-1) | np.isfinite(predictions.joints_3d).all(axis=-1)
    return np.nonzero(finite)


def _read_lines(file: Path) -> tuple[dict[str, Any], Any]:
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    header, end = None, None
    with file.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            place = f"{file}:{number}"
            try:
                row = json.loads(line)
            except json.JSONDecodeError as error:
                if error.msg == "Extra data":
                    message, hint = "the line goes on after its JSON object", "write one object a line"
                else:
                    message, hint = f"not a line of JSON ({error.msg})", "the file may be cut short"
                raise PredictionsError(f"{place}: {message}", hint=f"{hint}; {_DESCRIBED}") from error
            except (ValueError, RecursionError) as error:  # a number of thousands of digits, thousands of brackets
                raise PredictionsError(f"{place}: not a line of JSON that can be read", hint=_DESCRIBED) from error
            if number == 1:
                header = row
                _check_header(file, header)  # before thousands of rows of something else
                continue
            if not isinstance(row, dict):
                raise PredictionsError(f"{place}: a row is a JSON object", hint=_DESCRIBED)
            if end is not None:
                raise PredictionsError(f"{place}: a row behind the last line", hint='`{"rows": n}` is the last line')
            if "frame" not in row and "rows" in row:
                end = row["rows"]
                continue
            _check_columns(place, row)
            for name in COLUMNS:
                columns[name].append(row.get(name))
    if header is None:
        raise PredictionsError(f"{file} is empty", hint=_DESCRIBED)
    rows = len(columns["frame"])
    if end != rows:
        said = "has no last line" if end is None else f"should have {end} rows"
        raise PredictionsError(
            f"{file} is cut short: it {said}, and {rows} rows are there",
            hint='write it again; its last line is `{"rows": n}`, with the number of rows',
        )
    return columns, header


# ---------------------------------------------------------------------------------------------------------- Parquet


def _need_pyarrow() -> None:
    if find_spec("pyarrow") is None:
        raise DependencyError(
            "Parquet needs pyarrow, which is not installed", hint='pip install "cabinpose[parquet]", or use JSON lines (.jsonl)'
        )


def _pyarrow() -> Any:
    _need_pyarrow()
    import pyarrow.parquet as parquet  # noqa: PLC0415 - an extra

    return parquet


def _write_parquet(path: Path, header: Mapping[str, Any], predictions: Predictions) -> None:
    parquet = _pyarrow()
    import pyarrow as pa  # noqa: PLC0415 - an extra

    f, p, j = _found(predictions)
    numbers = np.column_stack([getattr(predictions, name)[f, p, j] for name in POSE_ARRAYS]).astype(np.float32)
    blind = np.flatnonzero(predictions.reason != "")
    none, no_numbers = [None] * len(blind), np.full((len(blind), len(_NUMBERS)), np.nan, np.float32)
    numbers = np.concatenate((numbers, no_numbers))
    columns = {
        "frame": pa.array(predictions.frame[np.concatenate((f, blind))]),
        "person": pa.array([*np.array(predictions.persons)[p].tolist(), *none], pa.string()),
        "joint": pa.array([*np.array(predictions.joints)[j].tolist(), *none], pa.string()),
    } | {name: pa.array(numbers[:, i], from_pandas=True) for i, name in enumerate(_NUMBERS)}  # NaN becomes null
    if blind.size:
        columns["reason"] = pa.array([*[None] * len(f), *map(str, predictions.reason[blind])], pa.string())
    table = pa.table(columns).replace_schema_metadata({_PARQUET_KEY: json.dumps(header).encode()})
    parquet.write_table(table, path)


def _read_parquet(file: Path) -> tuple[dict[str, Any], Any]:
    parquet = _pyarrow()
    import pyarrow as pa  # noqa: PLC0415 - an extra

    if not file.is_file():
        raise FileNotFoundError(file)
    try:
        head = parquet.read_metadata(file)
        groups = [head.row_group(i) for i in range(head.num_row_groups)]
        check_claim(file, max(_ROW_BYTES * head.num_rows, sum(group.total_byte_size for group in groups)))
        table = parquet.read_table(file, read_dictionary=["person", "joint", "reason"])  # in which a long name stands once
        metadata = table.schema.metadata or {}
        header = json.loads(metadata.get(_PARQUET_KEY, b"null"))
    except (pa.ArrowException, ValueError, RecursionError) as error:
        raise PredictionsError(
            f"{file} is no whole Parquet file ({error})", hint="the file may be cut short; write it again"
        ) from error
    if _PARQUET_KEY not in metadata:
        raise PredictionsError(f"{file} lacks the key 'cabinpose' in its metadata", hint=_DESCRIBED)
    _check_header(file, header)
    _check_columns(str(file), table.column_names)
    for name in ("frame", *_NUMBERS):
        kind = table.column(name).type if name in table.column_names else pa.null()
        if not (pa.types.is_primitive(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind)):
            raise PredictionsError(f"{file}: the column {name} holds {kind}, no numbers", hint=_DESCRIBED)
    empty = [None] * table.num_rows
    return {name: _values(table.column(name)) if name in table.column_names else empty for name in COLUMNS}, header


def _values(column: Any) -> list[Any]:
    """A column's values, each word of a dictionary made once."""
    values: list[Any] = []
    for chunk in column.chunks:
        words = getattr(chunk, "dictionary", None)
        if words is None:
            values += chunk.to_pylist()
        else:
            of = words.to_pylist()
            values += [None if i is None else of[i] for i in chunk.indices.to_pylist()]
    return values


# ----------------------------------------------------------------------------------------------------------- checks


def _check_columns(place: str, names: Iterable[str]) -> None:
    """Raise `PredictionsError` for a column that the format does not have."""
    if unknown := sorted(set(names) - set(COLUMNS)):
        raise PredictionsError(f"{place}: unknown column {', '.join(unknown)}", hint=f"columns are {', '.join(COLUMNS)}")


def _check_header(file: Path, header: Any) -> None:
    """Raise `PredictionsError` for a header that is not this format's."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise PredictionsError(f"{file} is no predictions file", hint=f'its header says `"format": "{FORMAT}"`; {_DESCRIBED}')
    if header.get("version") != VERSION:
        raise PredictionsError(
            f"{file} has version {header.get('version')}, this program reads version {VERSION}", hint="upgrade cabinpose"
        )
    if unknown := sorted(header.keys() - set(_HEADER_KEYS)):
        raise PredictionsError(f"{file}: unknown key {', '.join(unknown)} in the header", hint=f"keys: {', '.join(_HEADER_KEYS)}")
    for key in ("joints", "persons"):
        names = header.get(key)
        if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
            raise PredictionsError(f"{file}: the header's '{key}' is no list of different names", hint=_DESCRIBED)
    remarks = header.get("remarks", [])
    if not isinstance(remarks, list) or not all(isinstance(remark, str) for remark in remarks):
        raise PredictionsError(f"{file}: the header's 'remarks' are no list of texts", hint=_DESCRIBED)
    try:
        in_ranges(str(header.get("trained_on", "")), np.zeros(0, np.int64))
    except ValueError as error:
        raise PredictionsError(f"{file}: the header's 'trained_on' are {error}", hint=_DESCRIBED) from error
    if not isinstance(header.get("model"), str):
        raise PredictionsError(f"{file}: the header does not name the model", hint='add `"model": "name"`')


def _dense(file: Path, columns: Mapping[str, list[Any]], header: Mapping[str, Any]) -> Predictions:
    """The table as arrays; `PredictionsError` for the first row that is wrong."""
    persons, joints = tuple(header["persons"]), tuple(header["joints"])
    numbered = columns["frame"]
    whole = [isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 1 << 62 for number in numbered]
    _refuse(
        file,
        ~np.array(whole, bool),
        lambda row: f": frame {numbered[row]!r} is no frame number",
        "frames are whole numbers from 0",
    )
    told = _reasons(file, columns)
    columns = {name: values[: len(values) - len(told)] for name, values in columns.items()}
    p = _positions(file, "person", columns["person"], persons)
    j = _positions(file, "joint", columns["joint"], joints)
    frame, at = np.unique(np.array(numbered, np.int64), return_inverse=True)
    f, blind = at[: len(p)], at[len(p) :]
    twice = np.bincount(at, minlength=1)[blind] > 1
    doubled = np.concatenate((np.zeros(len(p), bool), twice))
    said = ": frame {} has rows beside its reason".format
    _refuse(file, doubled, lambda row: said(numbered[row]), "a reason stands for all the frame's joints")
    values = {name: _numbers(file, name, columns[name]) for name in _NUMBERS}
    _check_values(file, values)
    cell = (f * len(persons) + p) * len(joints) + j
    _, first, counts = np.unique(cell, return_index=True, return_counts=True)
    if (counts > 1).any():
        row = int(first[counts > 1].min())
        raise PredictionsError(
            f"{file}: frame {numbered[row]}, {columns['person'][row]}, {columns['joint'][row]} has {int(counts.max())} rows",
            hint="one row for each joint of a person in a frame",
        )
    batch = empty_batch(len(frame), len(persons), len(joints))
    batch.joints_2d[f, p, j] = np.stack((values["u"], values["v"]), axis=-1)
    batch.joints_3d[f, p, j] = np.stack((values["x"], values["y"], values["z"]), axis=-1)
    for name in ("score", "presence", "expected_error_m"):
        getattr(batch, name)[f, p, j] = values[name]
    batch.reason[blind] = told
    remarks = (*header.get("remarks", ()), *_remarks(columns))
    return Predictions(
        **vars(replace(batch, remarks=remarks)), frame=frame, persons=persons, joints=joints, model=header["model"],
        skeleton=str(header.get("skeleton", "cabinpose")), dataset=header.get("dataset"),
        trained_on=str(header.get("trained_on", "")), joint_definition=str(header.get("joint_definition", "")),
    )  # fmt: skip


def _reasons(file: Path, columns: Mapping[str, list[Any]]) -> list[str]:
    """The reasons of the last rows, which are those of frames in which nobody can be seen."""
    given = columns["reason"]
    there = np.array([reason is not None for reason in given], bool)
    told = given[len(given) - int(there.sum()) :]
    _refuse(file, there[: len(given) - len(told)], lambda _: " has a reason and stands before rows of joints", "write it last")
    bad = np.zeros(len(given), bool)
    for row in np.flatnonzero(there):
        beside = any(columns[name][row] is not None for name in COLUMNS[1:-1])
        bad[row] = beside or not isinstance(given[row], str) or not given[row].strip()
    _refuse(file, bad, lambda _: ": a reason is a text beside the frame alone", "it says why nobody can be seen in the frame")
    return told


def _refuse(file: Path, wrong: NDArray[np.bool_], what: Callable[[int], str], hint: str) -> None:
    """Raise `PredictionsError` for the first row that is wrong; what: the rest of the message, by the row's index."""
    if wrong.any():
        row = int(wrong.argmax())
        raise PredictionsError(f"{file}: row {row + 1}{what(row)}", hint=hint)


def _positions(file: Path, kind: str, names: list[Any], known: tuple[str, ...]) -> NDArray[np.int64]:
    """Of each name, its position among the known ones."""
    index = {name: i for i, name in enumerate(known)}
    unknown = np.array([not isinstance(name, str) or name not in index for name in names], bool)
    _refuse(file, unknown, lambda row: f": unknown {kind} {names[row]!r}", f"the header's {kind}s are {', '.join(known)}")
    return np.array([index[name] for name in names], np.int64)


def _numbers(file: Path, name: str, values: list[Any]) -> NDArray[np.float32]:
    """A column as float32, NaN for null; a score or presence that is left out is 1."""
    missing = 1.0 if name in ("score", "presence") else np.nan
    try:
        numbers = np.array([missing if value is None else float(value) for value in values]).astype(np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise PredictionsError(f"{file}: column {name} holds something that is no number ({error})", hint=_DESCRIBED) from error
    wrong = ~np.isfinite(numbers) & np.array([value is not None for value in values], bool)
    hint = "leave out what was not found; null stands for no coordinate"
    _refuse(file, wrong, lambda row: f": {name} is {values[row]}", hint)
    return numbers


def _check_values(file: Path, values: Mapping[str, NDArray[np.float32]]) -> None:
    """Raise `PredictionsError` for the first row without a whole position, or with a presence that is no probability."""
    for names in (("u", "v"), ("x", "y", "z")):
        given = np.stack([np.isfinite(values[name]) for name in names])
        partial, some = given.any(axis=0) != given.all(axis=0), f" has some of {', '.join(names)}"
        _refuse(file, partial, lambda _, some=some: some, "give all of them or none")  # type: ignore[misc]
        _refuse_fillers(file, names, np.stack([values[name] for name in names], axis=-1))
    neither = np.isnan(values["u"]) & np.isnan(values["x"])
    _refuse(file, neither, lambda _: " has no position", "give u and v, or x, y and z, or leave the row out")
    outside = (values["presence"] < 0) | (values["presence"] > 1)
    _refuse(file, outside, lambda row: f": presence is a probability, not {values['presence'][row]:g}", _PROBABILITY)
    _refuse(file, values["expected_error_m"] < 0, lambda _: ": expected_error_m is below 0", "give metres, or leave it out")


def _refuse_fillers(file: Path, names: Sequence[str], positions: NDArray[np.float32]) -> None:
    """Raise `PredictionsError` where positions (N, 2 or 3) are what tools write for none, and cannot be one."""
    for filler in _FILLERS:
        filled = (positions == filler).all(axis=-1)
        if filled.sum() > (_MOST_FILLED if len(names) == 2 else 0):
            said = f": {', '.join(names)} are all {filler:g}, as in {int(filled.sum())} of {len(filled)} rows"
            _refuse(file, filled, lambda _, said=said: said, "leave out what was not found")  # type: ignore[misc]


def _remarks(columns: Mapping[str, list[Any]]) -> Iterator[str]:
    """What stands out in columns that are given in some rows only."""
    for name in ("score", "presence"):
        left_out = sum(value is None for value in columns[name])
        if 0 < left_out < len(columns[name]):
            yield f"{name} is left out in {left_out} of {len(columns[name])} rows of the file: it counts as 1 there"
