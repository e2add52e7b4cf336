"""Generate a small dataset from Python, as `cabinpose synth` does from the command line.

One car, the driver's view, ten scenes. Run it twice: the second run finds all parts and makes none.
"""

from __future__ import annotations

from pathlib import Path

from cabinpose.synth import CabinScene, Camera, Output, SynthConfig, generate

OUT = Path("my-dataset")


def main() -> None:
    config = SynthConfig(
        scene=CabinScene(cars=("sedan",), occupancy={"driver": 1.0, "front_passenger": 0.3}),
        camera=Camera(sensor="pico_monstar_105/3", views={"driver": 1.0}),
        output=Output(frames_per_part=5),
    )
    report = generate(config, 10, OUT, seed=1, workers=1, existing="resume")
    print(f"{report.frames} frames made, {report.frames_total} in {OUT}")
    if report.proposals:
        print(f"{100 * report.acceptance:.0f} % of {report.proposals} poses accepted, rejected: {dict(report.rejections)}")


if __name__ == "__main__":
    main()
