"""A model as one graph from a camera's images to joints in space, for programs that run it without this package.

Around the network stand what `JointPredictor` does in numpy: the frame resampled to the model's view by the camera's intrinsics
and lens, and the joints brought back to the camera, told by the definition of their set. Both are traced from torch and joined
with the network's own graph, whichever file that is in. So are the checks of frames in which nobody can be seen, and the errors
that are to be expected. What is not in it are words: reasons, remarks and warnings, and the trials of turned and scaled frames.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
import torch
from onnx import compose
from torch import Tensor, nn

from cabinpose.core import Camera, ConfigError, FrameBatch, ModelError, make_folder, told_as, whole_file
from cabinpose.estimate.expected_error import LEAST_SPREAD_M, SCORE_MARGIN
from cabinpose.estimate.found import RIGHT_BELOW, front_exchanged
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.onnx_model import WHOLE, OnnxModel, cameras_of, open_session
from cabinpose.estimate.settings import DepthUnit, ViewSettings
from cabinpose.estimate.sight_graph import Sight

TOLERANCE_M = 1e-4  # greatest difference between the graph and the predictor
OUTPUTS = ("joints_3d", "joints_2d", "presence", "score", "expected_error")
_OPSET = 18
_LENS = (-0.18, 0.06, 0.001, -0.0008, -0.01)  # of a trial camera: an ordinary lens of 90 degrees
_STEPS = 1025  # radii at which a lens is tried: where it folds at one, the rays beyond are not in the image


class _Into(nn.Module):
    """The camera's images as the model's view sees them: nearest pixel, 0 where the camera does not look; and whether nobody can
    be seen in them.
    """

    def __init__(self, settings: ViewSettings, unit: DepthUnit) -> None:
        super().__init__()
        self._sight = Sight(settings)
        self._view, self._unit = settings.view, unit
        self._rays = torch.from_numpy(settings.view.camera.rays.reshape(-1, 2).copy())  # (h w, 2)

    def forward(self, camera_k: Tensor, camera_dist: Tensor, depth: Tensor, *pictures: Tensor) -> tuple[Tensor, ...]:
        """Images (N, H, W), pinhole (3, 3) and lens (5,), float64, as (N, h, w) float32 each; (N,) bool."""
        n, height, width = depth.shape
        focal, centre = _focal(camera_k), _centre(camera_k)
        u, v = (_distorted(self._rays, camera_dist) * focal + centre).unbind(-1)
        inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5) & _unfolded(self._rays, camera_dist)
        column = u.round().clamp(min=0).minimum(_last(width)).long()
        row = v.round().clamp(min=0).minimum(_last(height)).long()
        at = row * width + column

        def seen(image: Tensor) -> Tensor:
            taken = image.reshape(n, -1).float().index_select(1, at)
            return torch.where(inside, taken, 0.0).reshape(n, self._view.height, self._view.width)

        z = seen(depth) / 1000.0 if self._unit == "mm" else seen(depth)
        valid = (z > 0) & (z <= self._view.max_depth_m)  # False for NaN
        looked = torch.where(valid, z, 0.0), *(seen(picture) for picture in pictures)
        return *looked, self._sight(inside.double().mean(), *looked)


class _Back(nn.Module):
    """What the network answers as joints of the camera: (u, v, z) of the view and logits as points, pixels and probabilities.

    A frame in which nobody can be seen has NaN and presence 0. The driver is at the wheel, which is where the model's file says,
    or else where the network sees it.
    """

    def __init__(self, model: OnnxModel) -> None:
        super().__init__()
        self._view, count = model.config.view, len(model.joints)
        self._drive_side = model.drive_side if "wheel" in model.answers else ""
        self.more: tuple[str, ...] = ("spreads",) if "spreads" in model.answers and model.expected_error else ()
        self.more += ("wheel",) if "wheel" in model.answers and not model.drive_side else ()
        self._exchanged = front_exchanged(model.persons)
        # Weights by which joints of one definition are told as another's: what they make of each joint alone.
        told = told_as(np.eye(count), model.joints, model.learnt, model.config.joint_set)
        self._told = torch.from_numpy(np.array(told, np.float64))
        self._expected = _Expected(model)

    def forward(
        self, camera_k: Tensor, camera_dist: Tensor, unseen: Tensor, joints: Tensor, inside: Tensor, visible: Tensor,
        present: Tensor, *more: Tensor,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        """joints_3d (N, P, J, 3) m in the camera frame, joints_2d (N, P, J, 2) px; presence, score, expected error (N, P, J)."""
        known = dict(zip(self.more, more, strict=True))
        spreads, wheel = known.get("spreads"), known.get("wheel")
        if wheel is not None or self._drive_side == "right":
            joints, inside, visible, present = (self._seated(values, wheel) for values in (joints, inside, visible, present))
            spreads = spreads if spreads is None else self._seated(spreads, wheel)
        uvz, view = joints.double(), self._view.camera
        xy = torch.stack(((uvz[..., 0] - view.cx) / view.fx, (uvz[..., 1] - view.cy) / view.fy), dim=-1)
        points = torch.cat((xy * uvz[..., 2:], uvz[..., 2:]), dim=-1)
        pixels = _distorted(xy, camera_dist) * _focal(camera_k) + _centre(camera_k)
        presence = torch.sigmoid(present.double())[..., None] * torch.sigmoid(inside.double())
        score = presence * torch.sigmoid(visible.double())
        expected = self._expected(score, spreads)
        return (
            _without(unseen, self._told @ points, torch.nan), _without(unseen, self._told @ pixels, torch.nan),
            _without(unseen, presence, 0.0), _without(unseen, score, 0.0), _without(unseen, expected, torch.nan),
        )  # fmt: skip

    def _seated(self, values: Tensor, wheel: Tensor | None) -> Tensor:
        """Values (N, P, ...) with the front row exchanged where the wheel is on the right; without `wheel` everywhere."""
        exchanged = values[:, self._exchanged]
        if wheel is None:
            return exchanged
        return torch.where((wheel < RIGHT_BELOW).reshape(-1, *[1] * (values.ndim - 1)), exchanged, values)


class _Expected(nn.Module):
    """`expected_errors` of a model: the table of each joint, filled up with steps of no width."""

    def __init__(self, model: OnnxModel) -> None:
        super().__init__()
        tables = [model.expected_error.get(name) for name in model.joints]
        cues = max([1, *(len(table["weights"]) for table in tables if table)])
        steps = max([2, *(len(table["doubt"]) for table in tables if table)])
        weights, doubt, error_m = (
            np.zeros((len(tables), cues)),
            np.zeros((len(tables), steps)),
            np.full((len(tables), steps), np.nan),
        )
        for j, table in enumerate(tables):
            if table:
                weights[j] = table["weights"]
                for array, values in ((doubt, table["doubt"]), (error_m, table["error_m"])):
                    array[j] = np.pad(np.asarray(values, np.float64), (0, steps - len(values)), mode="edge")
        width = np.diff(doubt)
        slope = np.divide(np.diff(error_m), width, out=np.zeros_like(width), where=width > 0)
        self._weights, self._from, self._width, self._slope, self._least = map(
            torch.from_numpy, (weights, doubt[:, :-1].copy(), width, slope, error_m[:, 0].copy())
        )

    def forward(self, score: Tensor, spreads: Tensor | None) -> Tensor:
        """(N, P, J) m, of scores (N, P, J) and spreads (N, P, J, C) of a network that answers with them."""
        cues = -score[..., None]
        if spreads is not None:
            sure = score.clamp(SCORE_MARGIN, 1 - SCORE_MARGIN)
            doubt = torch.log(1 - sure) - torch.log(sure)
            cues = torch.cat((doubt[..., None], torch.log(spreads.double().clamp(min=LEAST_SPREAD_M))), dim=-1)
        beyond = (cues * self._weights).sum(-1)[..., None] - self._from  # (N, P, J, steps)
        return self._least + (self._slope * torch.minimum(beyond.clamp(min=0.0), self._width)).sum(-1)


def _without(unseen: Tensor, values: Tensor, none: float) -> Tensor:
    """Values (N, ...) as float32, `none` in the frames (N,) in which nobody can be seen."""
    return torch.where(unseen.reshape(-1, *[1] * (values.ndim - 1)), none, values.float())


def _last(size: Any) -> Tensor:
    """The last pixel of a side, also where tracing has it as a tensor."""
    return torch.as_tensor(size, dtype=torch.float64) - 1


def _focal(camera_k: Tensor) -> Tensor:
    return torch.stack((camera_k[0, 0], camera_k[1, 1]))


def _centre(camera_k: Tensor) -> Tensor:
    return camera_k[:2, 2]


def _distorted(xy: Tensor, dist: Tensor) -> Tensor:
    """Ideal normalised coordinates (..., 2) as the lens has them: `Camera.distort`."""
    k1, k2, p1, p2, k3 = dist.unbind(0)
    x, y = xy.unbind(-1)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return torch.stack((dx, dy), dim=-1)


def _unfolded(xy: Tensor, dist: Tensor) -> Tensor:
    """(N,) whether the radial distortion grows all the way to points (N, 2): beyond, it maps rays back into the image."""
    k1, k2, _, _, k3 = dist.unbind(0)
    radius = xy.square().sum(-1).sqrt()
    tried = torch.linspace(0.0, float(radius.max()), _STEPS, dtype=torch.float64)
    r2 = tried * tried
    grows = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3)) > 0
    return radius <= torch.where(grows, torch.inf, tried).min()


def write_whole_graph(model: OnnxModel, out: Path, unit: DepthUnit) -> float:
    """Write a model as one graph from images to joints.

    Its inputs are `camera_k` (3, 3) and `camera_dist` (5,), float64, px and OpenCV's k1 k2 p1 p2 k3, `depth` (frames, height,
    width) and `amplitude` where the model reads it, of any size, of one camera. Its outputs are `joints_3d` (frames, persons,
    joints, 3) m in the camera frame, `joints_2d` px, `presence` and `score`, all float32.

    Parameters
    ----------
    model
        A model whose network answers with joints in its view: of `compact`.
    out
        The file, which is replaced.
    unit
        m: depth and amplitude are float32, depth in metres; mm: both are uint16, depth in millimetres.

    Returns
    -------
    float
        The greatest difference in m between the graph's joints and expected errors and the predictor's on frames of two cameras.

    Raises
    ------
    ConfigError
        For a model of another method, or that reads colours.
    ModelError
        Where the difference is above `TOLERANCE_M`.
    """
    if (
        not {"joints", "inside", "visible", "present"} <= set(model.answers)
        or "rgb" in model.config.inputs
        or "depth" not in model.config.inputs
    ):
        raise ConfigError(
            f"{model.name}, a model of {model.method.name} that reads {', '.join(model.config.inputs)}, has no whole graph",
            hint="give one of compact that reads depth, as in_car, five_seats, room and room_top",
        )
    network = onnx.load(str(model.path))
    graph = _joined_graph(model, network, unit)
    said = {
        "name": model.name,
        "persons": model.persons,
        "joints": model.joints,
        "unit": unit,
        "card": model.metadata.get("card", {}),
    }
    onnx.helper.set_model_props(graph, {WHOLE: json.dumps(said)})
    make_folder(out.parent)
    with whole_file(out, kind=ModelError) as partial:
        onnx.save(graph, str(partial))
        difference = _difference(model, partial, unit)
        if not difference <= TOLERANCE_M:
            raise ModelError(f"the whole graph's joints differ by {difference:.2g} m", hint="try another version of onnxruntime")
    return difference


def _joined_graph(model: OnnxModel, network: onnx.ModelProto, unit: DepthUnit) -> onnx.ModelProto:
    """What comes before the network, the network, and what comes behind it, as one graph; names of the parts do not meet."""
    images, config = list(model.config.inputs), model.config
    height, width = config.view.height, config.view.width
    # Traced as int32: the exporter knows no uint16, which the graph's inputs are given afterwards.
    kind = torch.int32 if unit == "mm" else torch.float32
    k, dist = torch.tensor(config.view.camera.k), torch.zeros(5, dtype=torch.float64)
    image = torch.ones((2, height + 1, width + 2), dtype=torch.float32).to(kind)
    people, count = len(model.persons), len(model.joints)
    of_joints = torch.ones(2, people, count)
    answers = {"joints": torch.ones(2, people, count, 3), "inside": of_joints, "visible": of_joints, "present": of_joints[..., 0]}
    last, ways = _Back(model), max([2, *(len(table["weights"]) for table in model.expected_error.values())]) - 1
    more = {"spreads": torch.ones(2, people, count, ways), "wheel": torch.ones(2)}
    answers |= {name: more[name] for name in last.more}
    sides = {0: "frames", 1: "height", 2: "width"}
    with TemporaryDirectory() as folder:
        into = _traced(
            _Into(config, unit), Path(folder) / "into.onnx", {"camera_k": k, "camera_dist": dist} | dict.fromkeys(images, image),
            [*(f"seen_{name}" for name in images), "unseen"], dict.fromkeys(images, sides),
        )  # fmt: skip
        back = _traced(
            last, Path(folder) / "back.onnx",
            {"back_k": k, "back_dist": dist, "unseen": torch.zeros(2, dtype=torch.bool)} | answers,
            list(OUTPUTS), {name: {0: "frames"} for name in ("unseen", *answers)},
        )  # fmt: skip
    if unit == "mm":
        for entry in into.graph.input:
            if entry.name in images:
                entry.type.tensor_type.elem_type = onnx.TensorProto.UINT16
        del into.graph.value_info[:]
    version = max(each.ir_version for each in (into, network, back))
    for each in (into, network, back):
        each.ir_version = version
    network = compose.add_prefix(network, "network/", rename_inputs=True, rename_outputs=True)
    back = compose.add_prefix(back, "back/", rename_inputs=True, rename_outputs=False)
    fed = [(f"seen_{name}", f"network/{name}") for name in images]
    first = compose.merge_models(into, network, io_map=fed)
    whole = compose.merge_models(
        first, back, io_map=[("unseen", "back/unseen"), *((f"network/{name}", f"back/{name}") for name in answers)],
        outputs=list(OUTPUTS),
    )  # fmt: skip
    for node in whole.graph.node:  # the camera is given once
        node.input[:] = [{"back/back_k": "camera_k", "back/back_dist": "camera_dist"}.get(name, name) for name in node.input]
    kept = [entry for entry in whole.graph.input if not entry.name.startswith("back/")]
    del whole.graph.input[:]
    whole.graph.input.extend(kept)
    return whole


def _traced(
    module: nn.Module, path: Path, inputs: Mapping[str, Tensor], outputs: list[str], free: Mapping[str, Mapping[int, str]]
) -> onnx.ModelProto:
    """A module as a graph whose axes in `free` may have any size."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that traces is deprecated, and needs nothing beside torch and onnx
        torch.onnx.export(
            module.eval(), tuple(inputs.values()), str(path), input_names=list(inputs), output_names=outputs, dynamo=False,
            opset_version=_OPSET, do_constant_folding=False, dynamic_axes={**free, **{name: {0: "frames"} for name in outputs}},
        )  # fmt: skip
    return onnx.load(str(path))


def _difference(model: OnnxModel, path: Path, unit: DepthUnit) -> float:
    """The greatest distance in m between the graph's joints and the predictor's, on made-up frames of two cameras."""
    session, predictor, greatest = open_session(path, threads=1), JointPredictor(model), 0.0
    view, rng = model.config.view, np.random.Generator(np.random.Philox(key=1))
    narrower = Camera(
        view.width + 40, view.height - 9, 1.1 * view.focal, 1.07 * view.focal, view.width / 2 + 17.3, view.height / 2 - 8.1
    )
    curved = Camera(
        2 * view.width, 2 * view.height, 1.9 * view.focal, 1.9 * view.focal, view.width - 3.2, view.height + 2.4, _LENS
    )
    for camera in (narrower, curved):
        coarse = rng.uniform(0.4, 0.9 * view.max_depth_m, (2, camera.height // 16 + 1, camera.width // 16 + 1))
        depth_mm = np.round(1000 * coarse.repeat(16, 1).repeat(16, 2)[:, : camera.height, : camera.width]).astype(np.uint16)
        depth_mm[rng.random(depth_mm.shape) < 0.1] = 0
        depth_m = depth_mm.astype(np.float32) / np.float32(1000)
        light = np.round(150.0 / np.maximum(depth_m, 0.3) ** 2).astype(np.uint16)
        frames = FrameBatch(depth=depth_m, camera_k=camera.k, camera_dist=np.array(camera.dist), amplitude=light)
        cameras = cameras_of(frames, slice(None))
        poses = predictor.poses(predictor.found(predictor.seen(frames, slice(None), cameras), frames, slice(None)), cameras)
        images = {
            "depth": depth_mm if unit == "mm" else depth_m,
            "amplitude": light if unit == "mm" else light.astype(np.float32),
        }
        given = {"camera_k": camera.k, "camera_dist": np.array(camera.dist)} | {
            name: images[name] for name in model.config.inputs
        }
        joints, expected = session.run(["joints_3d", "expected_error"], given)
        apart = np.linalg.norm(joints - poses.joints_3d, axis=-1)
        known = ~np.isnan(poses.expected_error_m)
        apart[known] = np.maximum(apart[known], np.abs(expected - poses.expected_error_m)[known])
        greatest = float(np.maximum(greatest, apart.max()))  # NaN stays
    return greatest
