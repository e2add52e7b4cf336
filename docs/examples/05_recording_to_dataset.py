"""From devices to a dataset: a rig's session, recorded, calibrated, aligned, and a detector judged and trained on what comes out.

The devices are those of the virtual laboratory, played into the recorder as if they were there. With a real rig, name its
sources in the YAML in place of the replayed ones (docs/recording.md), and record the takes of docs/alignment.md.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from cabinpose.app.cli import main as cabinpose

SUBJECTS = ("S01", "S02")
LAB, RECORDED = Path("lab"), Path("recorded")
RIG = """
take:
  action: drive
  car: sedan
  subjects: [{{code: {subject}, seat: driver}}]
sources:
  suit: {{kind: replay, path: {path}, source: suit, speed: 0, host_time: true}}
  optical: {{kind: replay, path: {path}, source: optical, speed: 0, host_time: true}}
  tof: {{kind: replay, path: {path}, source: tof, speed: 0, host_time: true}}
"""
TRAINING = """
method: compact
settings: {slots: [driver]}
epochs: 1
batch: 8
"""


def run(*words: str) -> None:
    """One command, as it is typed."""
    print("$ cabinpose", *words)
    if cabinpose(list(words)):
        raise SystemExit("that failed")


def main() -> None:
    run("lab", "--out", str(LAB), "--subjects", *SUBJECTS, "--seconds", "8", "--rate-hz", "4", "--views", "14", "--no-exercises")
    RECORDED.mkdir(exist_ok=True)
    takes = []
    for subject in SUBJECTS:
        rig, take = RECORDED / f"rig-{subject}.yaml", RECORDED / f"drive-{subject}.mcap"
        rig.write_text(RIG.format(subject=subject, path=(LAB / take.name).resolve()))
        run("record", "--config", str(rig), "--out", str(take))
        takes.append(str(take))
    run("info", takes[0])
    run("calibrate", str(LAB / "session.yaml"), "--out", "calibration.yaml")
    run("align", *takes, "--calibration", "calibration.yaml", "--out", "aligned")
    run("view", "aligned", "--out", "aligned-view")
    run("evaluate", "aligned", "--model", "in_car", "--persons", "driver", "--resamples", "0")
    if find_spec("lightning") is not None:  # the extra `train`; one epoch shows the way, no more
        Path("train.yaml").write_text(TRAINING)
        run("train", "aligned", "--config", "train.yaml", "--out", "run")


if __name__ == "__main__":
    main()
