"""Reading JSON piece by piece gives what the standard library gives at once, however the file falls into chunks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.core.errors import DatasetError
from cabinpose.store.convert.json_stream import read_elements

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8)
values = st.recursive(
    scalars, lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=4), v, max_size=3), max_leaves=8
)


def flat(data: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(k, e) for k, v in data.items() for e in (v if isinstance(v, list) else [v])]


@given(
    data=st.dictionaries(st.text(max_size=5), values, max_size=4),
    chunk=st.integers(1, 9),
    indent=st.sampled_from([None, 1]),
    plain=st.booleans(),
)
def test_the_same_as_all_at_once(
    tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any], chunk: int, indent: int | None, plain: bool
) -> None:
    path = tmp_path_factory.mktemp("json") / "a.json"
    path.write_text(json.dumps(data, indent=indent, ensure_ascii=plain), encoding="utf-8")
    assert list(read_elements(path, chunk)) == flat(data)


def test_numbers_are_not_cut_at_the_end_of_a_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"a": 123456789, "b": [12, 3.25e-2]}')
    for chunk in range(1, 40):
        assert list(read_elements(path, chunk)) == [("a", 123456789), ("b", 12), ("b", 0.0325)]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1]",
        '{"a": [1, 2',
        '{"a": 1',
        '{"a" 1}',
        '{"a": [1 2]}',
        '{"a": 1} 2',
        "{1: 2}",
        '{"a": "b',
        '{"a": 1,}',
        b'{"a": "\xff"}',
    ],
)
def test_what_is_no_whole_object(tmp_path: Path, text: str | bytes) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DatasetError, match="no whole JSON object") as error:
        list(read_elements(path, 3))
    assert error.value.hint


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="No such file"):
        list(read_elements(tmp_path / "none.json"))


def test_one_element_is_held_at_a_time(tmp_path: Path) -> None:
    """Memory follows the largest element, not the file: 20 MB of elements of 100 bytes."""
    import tracemalloc

    path = tmp_path / "a.json"
    row = json.dumps({"keypoints": list(range(20))})
    with path.open("w") as file:
        file.write('{"annotations": [' + ",".join([row] * 200_000) + "]}")
    size = path.stat().st_size
    tracemalloc.start()
    count = sum(1 for _ in read_elements(path, 1 << 16))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 200_000
    assert peak < size / 20
