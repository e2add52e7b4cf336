"""docs/training.md: every key with its default, and the examples as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import small
import yaml
from pydantic import BaseModel

from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.estimate.methods import METHODS
from cabinpose.estimate.predictor import describe_model, packaged_models
from cabinpose.estimate.settings import AugmentConfig, ViewSettings
from cabinpose.estimate.training import TrainConfig, frame_spec
from cabinpose.store.split import parse_splits

PAGE = (Path(__file__).parents[2] / "docs" / "training.md").read_text("utf-8")
SECTIONS: dict[str, type[BaseModel]] = {"## Configuration": TrainConfig, "### Augmentation": AugmentConfig} | {
    f"### Settings of {name}": METHODS[name].settings_type for name in METHODS.names(own=True)
}
WORDS = {
    "the method's": None, "measured": None, "139 at a width of 352": None, "all five": OCCUPANT_SLOTS,
}  # fmt: skip


def rows(heading: str) -> dict[str, Any]:
    """The keys of a section's table and the defaults that it states."""
    section = re.split(r"^##", PAGE.split(f"{heading}\n", 1)[1], maxsplit=1, flags=re.M)[0]
    found: dict[str, Any] = {}
    for keys, default in re.findall(r"^\| (`[^|]+`) \| ([^|]+) \|", section, re.M):
        names = re.findall(r"`(\w+)`", keys)
        values = default.split(", ") if len(names) > 1 else [default]
        for name, value in zip(names, values, strict=True):
            read = WORDS[value] if value in WORDS else yaml.safe_load(value)
            found[name] = tuple(read) if isinstance(read, list) else read
    return found


@pytest.mark.parametrize("heading", SECTIONS)
def test_every_key_stands_with_its_default(heading: str) -> None:
    expected = {}
    for name, field in SECTIONS[heading].model_fields.items():
        of_method = field.default_factory_takes_validated_data
        default = None if of_method else field.get_default(call_default_factory=True)
        expected[name] = {} if isinstance(default, BaseModel) else default
    assert rows(heading) == expected


@pytest.mark.parametrize("settings", [s for s in SECTIONS.values() if issubclass(s, ViewSettings)])
def test_the_stated_focal_length_is_the_views(settings: type[ViewSettings]) -> None:
    assert settings(width=176).view.focal == pytest.approx(139 / 2)


def test_the_stated_rates_are_the_methods() -> None:
    networks = {name: METHODS[name] for name in small.NETWORKS}
    rates = {name: method.learning_rate for name, method in networks.items()}
    decays = {name: method.weight_decay for name, method in networks.items()}
    assert "compact and yolo 3e-3, paf 4e-4, lifting and unet 1e-3" in PAGE
    assert rates == {"compact": 3e-3, "paf": 4e-4, "lifting": 1e-3, "unet": 1e-3, "yolo": 3e-3}
    assert "compact and yolo 0.02, the others 0.01" in PAGE
    assert decays == {"compact": 0.02, "paf": 0.01, "lifting": 0.01, "unet": 0.01, "yolo": 0.02}


def test_the_examples_are_valid() -> None:
    splits, mixed, run, from_packaged = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.S))
    assert set(parse_splits(splits, "docs")) == {"train", "validate"}
    assert TrainConfig.model_validate(mixed).data["itop"].places == {"standing": "driver"}
    config = TrainConfig.model_validate(run)
    assert frame_spec(config).slots == ("driver", "front_passenger")
    packaged = METHODS["compact"].settings(describe_model(packaged_models()["in_car"])["settings"]).model_dump(mode="json")
    assert TrainConfig.model_validate(from_packaged).settings == packaged  # what --init in_car begins with


def test_the_python_examples_run(trained: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import shutil

    import sphere_people

    monkeypatch.chdir(tmp_path)
    sphere_people.write(tmp_path / "my-dataset", sphere_people.manifest(frames=3, width=small.SIZE[0], height=small.SIZE[1]))
    for method, name in (("compact", "compact"), ("paf", "paf"), ("lifting", "lift"), ("unet", "parts")):
        shutil.copy(trained[method], tmp_path / f"{name}.onnx")
    scope: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.S):
        exec(block, scope)
    assert scope["poses"].joints_3d.shape == (3, 3, 20, 3)
    assert scope["lifted"].joints_3d.shape == (3, 3, 14, 3)
    assert scope["labels"].shape == (3, 48, 64)
