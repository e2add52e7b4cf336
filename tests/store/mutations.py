"""Files damaged at random, and readers that have to bear them: an error of the package, or what the file still says; no crash,
no hang, no memory for what a header claims.

    python tests/store/mutations.py mvnx 10000

runs a reader over so many damaged files and prints what came of them.
"""

from __future__ import annotations

import faulthandler
import json
import os
import re
import resource
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core.errors import CabinposeError

NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 62, (1 << 64) - 1)
_WORDS = (
    b"nan", b"inf", b"-1", b"1e308", b"99999999999999999999", b"9" * 5000, b"", b"\x00", "²".encode(), b"0x10", b"1_0", b"e",
    b"\xff\xfe", b"[" * 20_000,
)  # fmt: skip
_TOKEN = re.compile(rb"-?\d[\d.eE+-]*")
_MOST_MB = 400  # that a reader may need beyond what there was
_FILE_S = 20  # that one file may take
Read = Callable[[Path], object]


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """`data` with one to four faults: bytes and numbers changed, parts gone, twice or cut off."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not changed:
            break
        at = int(rng.integers(len(changed)))
        kind = int(rng.integers(8))
        if kind == 0:
            changed[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            changed[at] = int(rng.choice((0, 0xFF, 0x7F, 0x20)))
        elif kind == 2:  # a binary number, of either order
            size = int(rng.choice((1, 2, 4, 8)))
            value = NUMBERS[int(rng.integers(len(NUMBERS)))] & ((1 << 8 * size) - 1)
            changed[at : at + size] = value.to_bytes(size, "little" if rng.integers(2) else "big")
        elif kind in (3, 4):  # a number as text
            found = _TOKEN.search(changed, at)
            if found is not None and found.end() - found.start() < 40:
                changed[found.start() : found.end()] = _WORDS[int(rng.integers(len(_WORDS)))]
        elif kind == 5:
            del changed[at:]
        elif kind == 6:
            del changed[at : at + int(rng.integers(1, 40))]
        else:
            changed[at:at] = changed[at : at + int(rng.integers(1, 200))]
    return bytes(changed)


@dataclass(frozen=True)
class Survived:
    """How many files were read, and how many refused; megabytes needed beyond what there was; s of the slowest file."""

    read: int
    refused: int
    grown_mb: float
    slowest_s: float


Fault = Callable[[bytes, np.random.Generator], bytes]


def survive(
    read: Read, original: bytes, folder: Path, suffix: str, *, count: int, seed: int = 0, most_mb: int = _MOST_MB,
    fault: Fault = mutated,
) -> Survived:  # fmt: skip
    """Let `read` have `count` damaged files in a process of its own. AssertionError where it does not bear one, which is kept."""
    folder.mkdir(exist_ok=True)
    told = folder / "told.json"
    child = os.fork()
    if child == 0:
        os._exit(
            _child(
                read, (fault(original, rng) for rng in [np.random.default_rng(seed)] for _ in range(count)), folder, suffix, told
            )
        )
    _, status = os.waitpid(child, 0)
    found = json.loads(told.read_text()) if told.exists() else {}
    place = f"{folder / f'damaged{suffix}'}, seed {seed}"
    assert status == 0, f"{place}: ended with {os.waitstatus_to_exitcode(status)}: {found.get('trace', 'a crash or a hang')}"
    assert found["grown_mb"] < most_mb, f"{place}: {found['grown_mb']:.0f} MB more"
    return Survived(found["read"], found["refused"], found["grown_mb"], found["slowest_s"])


def _child(read: Read, files: Iterator[bytes], folder: Path, suffix: str, told: Path) -> int:
    faulthandler.disable()  # the exit code tells
    server: Any = forkserver._forkserver
    modules = server._preload_modules
    server.__init__()  # that of the suite is no child of this process, which starts its own
    server.set_forkserver_preload(modules)
    sys.stdout = sys.stderr = (folder / "said.txt").open("w")
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # a hang ends the process
    path = folder / f"damaged{suffix}"
    fates: Counter[str] = Counter()
    slowest, before = 0.0, _most_mb()
    for content in files:
        path.write_bytes(content)
        signal.alarm(_FILE_S * 10)  # of wall time, on a machine that has other work
        began = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read(path)
            fates["read"] += 1
        except CabinposeError:
            fates["refused"] += 1
        except BaseException:  # noqa: BLE001 - whatever it is, it is what is looked for
            told.write_text(json.dumps({"trace": traceback.format_exc()}))
            return 1
        slowest = max(slowest, time.process_time() - began)
    signal.alarm(0)
    told.write_text(
        json.dumps({"read": fates["read"], "refused": fates["refused"], "grown_mb": _most_mb() - before, "slowest_s": slowest})
    )
    return 0 if slowest < _FILE_S else 2


def _most_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    from tempfile import TemporaryDirectory

    from test_fuzz import ending, originals, reader

    name, many = sys.argv[1], int(sys.argv[2])
    with TemporaryDirectory() as place:
        for part, content in originals(name, Path(place)).items():
            done = survive(reader(name), content, Path(place) / part, ending(name), count=many, seed=1)
            sys.stdout.write(f"{name} {part}: {done}\n")
