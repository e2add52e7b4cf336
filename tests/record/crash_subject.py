"""Records numbered samples until it is killed; on stdout, host time and number of each sample that its device sent.

    python crash_subject.py OUT LIMIT_BYTES

LIMIT_BYTES > 0 is a limit on the size of files, which to a writer is a disk that is full. The variable STORAGE has the rig's
`storage` as JSON, TOF the settings of its camera.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from cabinpose.record.config import parse_rig
from cabinpose.record.session import begin
from cabinpose.record.sources.numbered import NumberedSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Sample


def main() -> None:
    out, limit = Path(sys.argv[1]), int(sys.argv[2])
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    read = NumberedSource.read

    def telling(self: NumberedSource, timeout_s: float) -> Sequence[Sample]:
        samples = read(self, timeout_s)
        for sample in samples:
            os.write(1, f"{self.name} {sample.host_ns} {sample.sequence}\n".encode())
        return samples

    NumberedSource.read = telling  # type: ignore[method-assign]
    rig = parse_rig(
        {
            "sources": {
                "suit": {"kind": "numbered", "rate_hz": 200},
                "tof": {"kind": "numbered", "rate_hz": 20, "width": 160, "height": 120} | json.loads(os.environ.get("TOF", "{}")),
            },
            "storage": json.loads(os.environ.get("STORAGE", "{}")),
        }
    )
    recorder = begin(rig, out, HostClock())
    while recorder.running:
        time.sleep(0.05)
    outcome = recorder.stop()
    for status in outcome.sources:
        os.write(1, f"end {status.source} {status.written} {status.dropped}\n".encode())
    os.write(1, f"error {outcome.error}\n".encode())


if __name__ == "__main__":
    main()
