"""Reading a JSON file of one large object piece by piece: a COCO file may be larger than memory, no element of it is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from cabinpose.core.errors import DatasetError

_CHUNK = 1 << 20  # characters
_IN_NUMBERS = "+-.eE0123456789"
_BLANK = " \t\r\n"


def read_elements(path: Path, chunk: int = _CHUNK) -> Iterator[tuple[str, Any]]:
    """(key, value) of the object in a file, in its order; a value that is an array comes element by element.

    Holds `chunk` characters and one element at a time. Raises `DatasetError` where the file is no JSON object or cut short.
    """
    try:
        with path.open(encoding="utf-8") as file:
            yield from _Reader(file, chunk).pairs()
    except (OSError, ValueError) as error:  # a JSONDecodeError is a ValueError
        raise DatasetError(
            f"{path} is no whole JSON object ({error})", hint="it may be cut short; copy it again, or give another file"
        ) from error


class _Reader:
    def __init__(self, file: TextIO, chunk: int) -> None:
        self._file, self._chunk = file, chunk
        self._text, self._at, self._ended = "", 0, False
        self._decoder = json.JSONDecoder()

    def pairs(self) -> Iterator[tuple[str, Any]]:
        self._expect("{")
        if self._peek() == "}":
            self._at += 1
        else:
            while True:
                key = self._value()
                if not isinstance(key, str):
                    raise ValueError("a key is text")
                self._expect(":")
                if self._peek() == "[":
                    for element in self._array():
                        yield key, element
                else:
                    yield key, self._value()
                if self._expect(",}") == "}":
                    break
        if self._peek():
            raise ValueError("it goes on after the end of the object")

    def _array(self) -> Iterator[Any]:
        self._expect("[")
        if self._peek() == "]":
            self._at += 1
            return
        while True:
            yield self._value()
            if self._expect(",]") == "]":
                return

    def _value(self) -> Any:
        """The value that begins here. A number that ends near the end of the text may go on behind it: 1 of 12, 3 of 3.5e2."""
        self._peek()
        while True:
            try:
                value, end = self._decoder.raw_decode(self._text, self._at)
                if self._ended or self._is_over(end):
                    self._at = end
                    return value
            except json.JSONDecodeError:
                if self._ended:
                    raise
            self._read(len(self._text))  # twice as much each time: the cost of decoding again stays proportional

    def _is_over(self, end: int) -> bool:
        while end < len(self._text) and self._text[end] in _IN_NUMBERS:
            end += 1
        return end < len(self._text)

    def _peek(self) -> str:
        """The next character that is no blank, "" at the end."""
        while True:
            while self._at < len(self._text):
                if self._text[self._at] not in _BLANK:
                    return self._text[self._at]
                self._at += 1
            if self._ended:
                return ""
            self._read(self._chunk)

    def _expect(self, characters: str) -> str:
        found = self._peek()
        if not found or found not in characters:
            raise ValueError(f"{found!r} where one of {' '.join(characters)} belongs" if found else "it ends too early")
        self._at += 1
        return found

    def _read(self, least: int) -> None:
        more = self._file.read(max(least, self._chunk))
        self._ended = not more
        self._text, self._at = self._text[self._at :] + more, 0
