"""What training does for each task: which frames a method needs, how they are varied, and how its answers are judged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cabinpose.core import class_table, confusion, intersection_over_union, whole_person
from cabinpose.estimate.augment import AugmentConfig, Mirror, augment, chance, draw_motion, flip, move_points
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import FrameSpec
from cabinpose.estimate.found import Found
from cabinpose.estimate.inputs import InputView

HEAD_M = 0.2  # PCKh's head in 3D (pose.md's protocol); in the image it is this length at the joint's depth
Figures = dict[str, float]


class Setting(NamedTuple):
    """What variation needs to know: the view's rays (2, h, w) x/z and y/z, its focal length (px), and what mirrors swap."""

    rays: Tensor
    focal: float
    mirror: Mirror


class PeopleBatch(NamedTuple):
    """P people to lift, in the place of a `Batch`.

    pose: (P, J, 3) x/z, y/z and 1 where the joint is given · joints: (P, J, 3) m, camera frame · known: (P, J) whose place is.
    """

    pose: Tensor
    joints: Tensor
    known: Tensor


def people_of(batch: Batch, view: InputView) -> PeopleBatch:
    """The people of a batch who are there; given are the joints that are in the image, known those whose place is."""
    at = batch.joints[batch.present]
    finite = torch.isfinite(at).all(-1)
    states = batch.visibility[batch.present]
    uvz = torch.nan_to_num(at)
    centre = uvz.new_tensor((view.camera.cx, view.camera.cy))
    xy = (uvz[..., :2] - centre) / view.focal
    given = (finite & (states > 1)).to(xy.dtype).unsqueeze(-1)
    joints = torch.cat((xy * uvz[..., 2:], uvz[..., 2:]), dim=-1)
    return PeopleBatch(torch.cat((xy * given, given), dim=-1), joints, finite & (states > 0))


def vary_people(batch: Batch, config: AugmentConfig, settings: Any, mirror: Mirror, *, generator: torch.Generator) -> PeopleBatch:
    """People moved and turned about the mean of their joints, mirrored, their 2D joints then noisy and some of them missing."""
    view = settings.view
    rotation, shift = draw_motion(len(batch.joints), config, batch.joints, generator)
    people = people_of(batch, view)
    z = batch.joints[..., 2:]
    at = batch.joints.new_tensor((view.camera.cx, view.camera.cy))
    points = torch.cat(((batch.joints[..., :2] - at) * z / view.focal, z), dim=-1)
    middle = torch.nan_to_num(points.nanmean(dim=2, keepdim=True))
    uvz = move_points(batch.joints, rotation, shift, middle, (view.camera.cx, view.camera.cy), view.focal)
    batch = flip(batch._replace(joints=uvz), chance(config.flip, batch.joints, generator), mirror, view.width)
    people = people_of(batch, view)
    n, j = people.known.shape

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=uvz.device)

    noise = torch.randn((n, j, 2), generator=generator, device=uvz.device) * settings.noise * uniform(n, 1, 1)
    left = (uniform(n, j) >= settings.drop * uniform(n, 1)).to(uvz.dtype).unsqueeze(-1)
    given = people.pose[..., 2:] * left
    return people._replace(pose=torch.cat(((people.pose[..., :2] + noise) * given, given), dim=-1))


class Task(ABC):
    """One task: what training and export ask of it. The defaults are those of the tasks on images.

    `best` names the validation figure whose greatest value marks the best epoch, `labels` says whether pixel classes are read.
    """

    best = "val_auc"
    labels = False

    def spec(self, settings: Any) -> FrameSpec:
        """What a method with these settings takes of each frame."""
        return FrameSpec(
            settings.view, settings.slots, settings.joint_set.name, settings.joints,
            amplitude="amplitude" in settings.inputs, labels=self.labels, rgb="rgb" in settings.inputs,
        )  # fmt: skip

    def vary(self, batch: Batch, config: AugmentConfig, settings: Any, setting: Setting, generator: torch.Generator) -> Any:  # noqa: ARG002 - lifting needs the settings
        """An augmented batch, as the method's loss takes it."""
        return augment(batch, config, setting.rays, setting.focal, setting.mirror, generator=generator)

    def plain(self, batch: Batch, settings: Any) -> Any:  # noqa: ARG002 - lifting needs the settings
        """A batch as the method's loss takes it, not augmented."""
        return batch

    def inputs(self, batch: Batch, settings: Any) -> dict[str, Tensor]:  # noqa: ARG002 - lifting needs the settings
        """What the view saw of a batch by name, among it the network's inputs; not augmented."""
        images = {"depth": batch.depth, "amplitude": batch.amplitude, "rgb": batch.rgb}
        return {name: image for name, image in images.items() if image is not None}

    def examples(self, settings: Any, generator: torch.Generator) -> dict[str, Tensor]:
        """Three plausible inputs of the network by name, to trace it with."""
        depth = 0.4 + 2 * torch.rand((3, settings.view.height, settings.view.width), generator=generator)
        depth[torch.rand(depth.shape, generator=generator) < 0.1] = 0.0
        values = {"depth": depth, "amplitude": 300 * torch.rand(depth.shape, generator=generator)}
        if "rgb" in settings.inputs:
            values["rgb"] = 255 * torch.rand((len(depth), 3, *depth.shape[1:]), generator=generator)
        return {name: values[name] for name in settings.inputs}

    @abstractmethod
    def errors(self, decoded: Any, batch: Batch, settings: Any) -> NDArray[Any]:
        """What validation collects of a batch: errors (K,) in heads, infinite = no answer, unless a task says otherwise."""

    @abstractmethod
    def judges(self, batch: Batch, settings: Any) -> bool:
        """Whether a batch shows anything that the validation figures are of."""

    def figures(self, errors: Sequence[NDArray[Any]]) -> Figures:
        """Validation figures from what was collected: PCKh@0.5 and the area under PCKh from 0 to 0.5, percent.

        None where nothing was collected.
        """
        all_ = np.concatenate(errors) if len(errors) else np.zeros(0)
        if not all_.size:
            return {}
        return {"val_pckh": float(100 * np.mean(all_ <= 0.5)), "val_auc": float(100 * np.mean(np.clip(1 - all_ / 0.5, 0, 1)))}


class Joints(Task):
    """Images to joints. Judged by the image errors, in heads, of the joints in the image of people who are there."""

    def errors(self, decoded: Found, batch: Batch, settings: Any) -> NDArray[np.float64]:
        truth = batch.joints.cpu().numpy().astype(np.float64)
        head_px = HEAD_M * settings.view.focal / truth[..., 2]
        error = np.linalg.norm(decoded.uv - truth[..., :2], axis=-1) / head_px
        known = batch.present.cpu().numpy()[..., None] & (batch.visibility.cpu().numpy() > 1) & np.isfinite(head_px)
        return np.asarray(np.where(np.isnan(error), np.inf, error)[known])

    def judges(self, batch: Batch, settings: Any) -> bool:  # noqa: ARG002 - parts need the settings
        return bool((batch.present.unsqueeze(-1) & (batch.visibility > 1) & torch.isfinite(batch.joints[..., 2])).any())


class Lift(Task):
    """2D joints to 3D. Judged by the errors in space, in heads, of the known joints of people with enough 2D joints."""

    def spec(self, settings: Any) -> FrameSpec:
        return FrameSpec(settings.view, settings.slots, settings.joint_set.name, settings.joints, depth=False, amplitude=False)

    def vary(self, batch: Batch, config: AugmentConfig, settings: Any, setting: Setting, generator: torch.Generator) -> Any:
        return vary_people(batch, config, settings, setting.mirror, generator=generator)

    def plain(self, batch: Batch, settings: Any) -> Any:
        return people_of(batch, settings.view)

    def inputs(self, batch: Batch, settings: Any) -> dict[str, Tensor]:
        return {"pose": self.plain(batch, settings).pose}

    def examples(self, settings: Any, generator: torch.Generator) -> dict[str, Tensor]:
        pose = torch.rand((3, len(settings.joints), 3), generator=generator) - 0.5
        pose[..., 2] = (pose[..., 2] > -0.3).to(pose.dtype)
        return {"pose": pose}

    def errors(self, decoded: NDArray[np.float64], batch: Batch, settings: Any) -> NDArray[np.float64]:
        people = people_of(batch, settings.view)
        error = np.linalg.norm(decoded - people.joints.cpu().numpy(), axis=-1) / HEAD_M
        return np.asarray(error[people.known.cpu().numpy() & np.isfinite(error)])

    def judges(self, batch: Batch, settings: Any) -> bool:
        people = people_of(batch, settings.view)
        return bool((people.known.any(dim=-1) & people.pose[..., 2].any(dim=-1)).any())


class Parts(Task):
    """Images to pixel classes. Judged by the mean IoU of the parts; collected are confusion matrices."""

    best = "val_iou"
    labels = True

    def spec(self, settings: Any) -> FrameSpec:
        return super().spec(settings)._replace(classes=tuple(number for part in settings.parts for number in part.ids))

    def errors(self, decoded: NDArray[np.uint8], batch: Batch, settings: Any) -> NDArray[np.int64]:
        if batch.labels is None:
            raise ValueError("the segmentation is judged by pixel classes")
        truth = class_table(settings.parts)[batch.labels.cpu().numpy()]
        return confusion(truth, decoded, len(settings.parts) + 1)

    def judges(self, batch: Batch, settings: Any) -> bool:
        return batch.labels is not None and bool(class_table(settings.parts)[batch.labels.cpu().numpy()].any())

    def figures(self, errors: Sequence[NDArray[Any]]) -> Figures:
        """Percent: mean IoU of the parts that are there or predicted, and the IoU of people as a whole."""
        if not len(errors):
            return {}
        counts = np.sum(errors, axis=0)
        parts = intersection_over_union(counts)[1:]
        person = intersection_over_union(whole_person(counts))[1]
        if np.isnan(parts).all() or np.isnan(person):
            return {}
        return {"val_iou": float(100 * np.nanmean(parts)), "val_person_iou": float(100 * person)}


TASKS: dict[str, Task] = {"joints": Joints(), "parts": Parts(), "lift": Lift()}
