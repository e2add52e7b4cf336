"""The cars of a dataset, built: presets, presets with dimensions changed, the user's own meshes, random ones by name."""

from __future__ import annotations

from cabinpose.core import DriveSide
from cabinpose.scene.cabin import PRESETS, Cabin, CabinDimensions, build_cabin, random_dimensions
from cabinpose.synth.cars import ChangedPreset, is_random_car
from cabinpose.synth.config import CabinScene, RoomScene, SynthConfig
from cabinpose.synth.once import cached_once
from cabinpose.synth.streams import CAR_STREAM, frame_rng
from cabinpose.synth.validate import Validator


class Cabins:
    """The cars of one dataset with who judges scenes in them. Holds those used last, a bounded number.

    names: every car, those that the configuration names first; none in a room. Own meshes go by their paths.
    """

    def __init__(self, scene: CabinScene | RoomScene, seed: int, *, like: Cabins | None = None) -> None:
        """like: those of a dataset whose cars are taken over where the seed makes the same ones."""
        cars = scene.cars if isinstance(scene, CabinScene) else ()
        self._changed = {car.name: car.dimensions for car in cars if isinstance(car, ChangedPreset)}
        self.names = scene.car_names if isinstance(scene, CabinScene) else ()
        self._seed = seed
        self._built = cached_once(20)(self._build)
        if like is not None and like._seed == seed:
            self._built = like._built

    def judged(self, car: str, drive_side: DriveSide) -> tuple[Cabin, Validator]:
        """A car by its name, with the wheel on a side."""
        return self._built(self._changed.get(car, car), drive_side)

    def _build(self, car: str | CabinDimensions, drive_side: DriveSide) -> tuple[Cabin, Validator]:
        return judged_cabin(car_dimensions(self._seed, car) if isinstance(car, str) and is_random_car(car) else car, drive_side)


def car_names(config: SynthConfig) -> tuple[str, ...]:
    """Every car of a dataset."""
    return Cabins(config.scene, 0).names


def car_dimensions(seed: int, car: str) -> CabinDimensions:
    """The dimensions of a random car, "C0000" ..., of the dataset of this seed, whatever was drawn before."""
    return random_dimensions(car, rng=frame_rng(seed, CAR_STREAM + int(car[1:])))


def open_cabin(car: str | CabinDimensions, drive_side: DriveSide) -> Cabin:
    """A preset by its name, a cabin by its dimensions, or a user's own by the path of its YAML file."""
    if isinstance(car, CabinDimensions) or car in PRESETS:
        return build_cabin(car, drive_side=drive_side)
    from cabinpose.scene.cabin import load_cabin  # noqa: PLC0415 - trimesh, for a user's own mesh alone

    return load_cabin(car)


def judged_cabin(car: str | CabinDimensions, drive_side: DriveSide) -> tuple[Cabin, Validator]:
    """A cabin and who judges scenes in it. A preset's are built once a process; a user's mesh may change between calls."""
    if isinstance(car, str) and car in PRESETS:
        return _judged_preset(car, drive_side)
    cabin = open_cabin(car, drive_side)
    return cabin, Validator(cabin)


@cached_once(16)
def _judged_preset(car: str, drive_side: DriveSide) -> tuple[Cabin, Validator]:
    cabin = open_cabin(car, drive_side)
    return cabin, Validator(cabin)
