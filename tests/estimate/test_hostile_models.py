"""Models of strangers: what they claim is held against the file before a runtime believes it, and nothing of theirs is run."""

from __future__ import annotations

import pickle
import resource
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core import check_onnx, read_arrays, run_onnx
from cabinpose.core.errors import ModelError
from cabinpose.estimate import packaged_models
from cabinpose.estimate.array_model import ArrayModel
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel
from cabinpose.estimate.remote import open_predictor

onnx = pytest.importorskip("onnx")


@pytest.fixture
def lift() -> onnx.ModelProto:
    """The smallest packaged model."""
    return onnx.load(str(packaged_models()["lift"]))


def tensor_of(model: onnx.ModelProto, *dims: int) -> onnx.TensorProto:
    array = model.graph.initializer.add(name="giant", data_type=onnx.TensorProto.FLOAT, raw_data=bytes(64))
    array.dims.extend(dims)
    return array


def endless(model: onnx.ModelProto) -> None:
    body = onnx.helper.make_graph([], "body", [], [])
    model.graph.node.insert(0, onnx.helper.make_node("Loop", ["", ""], ["out"], body=body))


def in_a_function(model: onnx.ModelProto) -> None:
    body = onnx.helper.make_graph([], "body", [], [])
    loop = onnx.helper.make_node("Loop", ["", ""], ["out"], body=body)
    model.functions.append(onnx.helper.make_function("x", "F", [], ["out"], [loop], [onnx.helper.make_opsetid("", 17)]))


def constant(model: onnx.ModelProto) -> None:
    shape = onnx.helper.make_tensor("shape", onnx.TensorProto.INT64, [3], [10**5, 10**5, 10**3])
    model.graph.initializer.append(shape)
    model.graph.node.insert(0, onnx.helper.make_node("ConstantOfShape", ["shape"], ["out"]))


def elsewhere(model: onnx.ModelProto) -> None:
    array = tensor_of(model, 16)
    array.ClearField("raw_data")
    array.data_location = onnx.TensorProto.EXTERNAL
    array.external_data.add(key="location", value="../../etc/passwd")


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (endless, "Loop holds a graph"),
        (in_a_function, "Loop holds a graph"),
        (constant, "ConstantOfShape makes 10000000000000 numbers"),
        (elsewhere, "weights lie in another file"),
        (lambda model: tensor_of(model, 1 << 20, 1 << 20), "'giant' claims 1099511627776 numbers in"),
        (lambda model: tensor_of(model, 1 << 62, 1 << 62), "'giant' claims"),
    ],
)
def test_what_an_onnx_file_must_not_do(
    harm: Callable[[onnx.ModelProto], None], told: str, lift: onnx.ModelProto, tmp_path: Path
) -> None:
    path = tmp_path / "m.onnx"
    harm(lift)
    path.write_bytes(lift.SerializeToString())
    with pytest.raises(ModelError, match=told) as refused:
        open_predictor(str(path))
    assert refused.value.hint


def test_metadata_that_nests_deep(lift: onnx.ModelProto, tmp_path: Path) -> None:
    onnx.helper.set_model_props(lift, {METADATA_KEY: '{"a":' * 100_000})
    (tmp_path / "m.onnx").write_bytes(lift.SerializeToString())
    with pytest.raises(ModelError, match="does not say what it is"):
        open_predictor(str(tmp_path / "m.onnx"))


def test_cut_files_and_other_bytes_are_no_model(tmp_path: Path) -> None:
    sound = packaged_models()["lift"].read_bytes()
    for data in (sound[:1000], sound[: len(sound) // 2], b"", b"\xff" * 100, b"\x08" + b"\xff" * 11, pickle.dumps({"a": 1})):
        (tmp_path / "m.onnx").write_bytes(data)
        with pytest.raises(ModelError):
            open_predictor(str(tmp_path / "m.onnx"))


def growing(model: onnx.ModelProto, times: int) -> None:
    """An output that is a sum over `times` numbers for each frame of a batch: no file tells how many."""
    graph, onnx_, tag = model.graph, onnx.helper, f"{times}"
    graph.initializer.append(onnx_.make_tensor(f"of_each{tag}", onnx.TensorProto.INT64, [3], [times, 1, 1]))
    graph.initializer.append(onnx_.make_tensor(f"nought{tag}", onnx.TensorProto.FLOAT, [1], [0.0]))
    given, found = graph.input[0].name, graph.output[0].name
    for node in graph.node:
        node.output[:] = [f"found{tag}" if name == found else name for name in node.output]
    graph.node.extend(
        [
            onnx_.make_node("Shape", [given], [f"shape{tag}"]),
            onnx_.make_node("Mul", [f"shape{tag}", f"of_each{tag}"], [f"many{tag}"]),
            onnx_.make_node("Expand", [f"nought{tag}", f"many{tag}"], [f"numbers{tag}"]),
            onnx_.make_node("ReduceSum", [f"numbers{tag}"], [f"sum{tag}"], keepdims=0),
            onnx_.make_node("Add", [f"found{tag}", f"sum{tag}"], [found]),
        ]
    )


def test_memory_of_a_run_is_bounded(lift: onnx.ModelProto, tmp_path: Path) -> None:
    path, sound = tmp_path / "m.onnx", OnnxModel(packaged_models()["lift"], threads=1)
    seen = {name: np.ones((4, 14, 3), np.float32) for name in sound.config.inputs}
    expected = sound.outputs(seen)
    growing(lift, 100)
    path.write_bytes(lift.SerializeToString())
    for name, values in OnnxModel(path, threads=1).outputs(seen).items():
        np.testing.assert_allclose(values, expected[name], rtol=1e-5, atol=1e-6)
    growing(lift, 30_000_000)
    path.write_bytes(lift.SerializeToString())
    model, before = OnnxModel(path, threads=1), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ModelError, match=r"cannot be run: .* smaller than requested bytes of 5040000000") as told:
        model.outputs(seen)
    assert "2 GB" in told.value.hint
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000
    for name, values in sound.outputs(seen).items():  # others run on
        np.testing.assert_array_equal(values, expected[name])


def test_a_batch_that_does_not_fit_goes_in_halves() -> None:
    class Session:
        def __init__(self, most: int) -> None:
            self.most, self.sizes = most, list[int]()

        def run(self, names: list[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
            self.sizes.append(len(inputs["a"]))
            if len(inputs["a"]) > self.most:
                raise RuntimeError("void f(x) no room")
            return [inputs["a"] + inputs["b"]] * len(names)

    inputs, session = {"a": np.arange(7.0), "b": np.ones(7)}, Session(2)
    (found,) = run_onnx(session, Path("m.onnx"), ["sum"], inputs)
    np.testing.assert_array_equal(found, np.arange(7.0) + 1)
    assert session.sizes == [7, 3, 1, 2, 4, 2, 2]
    with pytest.raises(ModelError, match=r"^m.onnx cannot be run: no room$"):
        run_onnx(Session(0), Path("m.onnx"), ["sum"], inputs)


def test_weights_that_are_no_numbers_are_told(lift: onnx.ModelProto, tmp_path: Path) -> None:
    assert [check_onnx(path) for path in packaged_models().values()] == [0] * len(packaged_models())
    weights = max((each for each in lift.graph.initializer if each.raw_data), key=lambda each: len(each.raw_data))
    values = onnx.numpy_helper.to_array(weights).copy()
    values.flat[0] = np.nan
    weights.CopyFrom(onnx.numpy_helper.from_array(values, weights.name))
    (tmp_path / "m.onnx").write_bytes(lift.SerializeToString())
    with pytest.warns(
        UserWarning, match=r"has 1 tensors of weights with values that are not numbers \(NaN\): it may find nothing"
    ):
        OnnxModel(tmp_path / "m.onnx")


def test_answers_that_are_no_numbers_are_told_once(monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder) -> None:
    class Session:
        def run(self, names: list[str], _: object) -> list[np.ndarray]:
            return [np.full((1, 2), np.nan, np.float32) for _ in names]

    model = OnnxModel(packaged_models()["lift"])
    monkeypatch.setattr(model, "session", Session())
    seen = {name: np.zeros((1, 2), np.float32) for name in model.config.inputs}
    for _ in range(2):
        model.outputs(seen)
    assert [str(each.message).endswith("answers with values that are not numbers (NaN)") for each in recwarn.list] == [True]


class Harm:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("import pathlib; pathlib.Path('harmed').touch()",)


def bomb(path: Path) -> Path:
    """300 MB of zeros in 1.4 MB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive, archive.open("depth01.npy", "w") as entry:
        np.lib.format.write_array_header_1_0(entry, {"descr": "<f4", "fortran_order": False, "shape": (7500, 100, 100)})
        for _ in range(300):
            entry.write(bytes(1_000_000))
    return path


@pytest.mark.slow
def test_arrays_of_strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    files = {
        "bomb.npz": "it would unpack to 0.3 GB",
        "pickle.npz": "no whole .npz file",
        "objects.npz": "holds Python objects",
        "giant.npz": r"claims (1099511627776,) numbers",
        "text.npz": "no whole .npz file",
    }
    bomb(Path("bomb.npz"))
    Path("pickle.npz").write_bytes(pickle.dumps(Harm()))
    np.savez("objects.npz", depth01=np.array([Harm()], object))
    with zipfile.ZipFile("giant.npz", "w") as archive, archive.open("depth01.npy", "w") as entry:
        np.lib.format.write_array_header_1_0(entry, {"descr": "<f4", "fortran_order": False, "shape": (1 << 40,)})
    Path("text.npz").write_text("PK but no archive")
    for name, told in files.items():
        began = time.process_time()
        with pytest.raises(ValueError, match=told.replace("(", r"\(").replace(")", r"\)")):
            read_arrays(Path(name))
        with pytest.raises(ModelError, match="cannot be read"):
            ArrayModel(name)
        assert time.process_time() - began < 2
        assert main(["evaluate", "--itop-npz", name, "--model", "room"]) == 2
        said = capsys.readouterr().err
        assert "Traceback" not in said
        assert "hint:" in said
    assert not Path("harmed").exists()


def test_sound_arrays_are_what_numpy_reads(tmp_path: Path) -> None:
    arrays = {
        "a": np.arange(12.0).reshape(3, 4),
        "b": np.array("text"),
        "c": np.zeros((0, 3), np.uint8),
        "f": np.eye(3, order="F"),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    found = read_arrays(tmp_path / "a.npz")
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array, strict=True)
    assert list(read_arrays(tmp_path / "a.npz", ("b", "none"))) == ["b"]
