"""The checks of `sight` as operators of a graph: whether anybody can be seen in what a view sees, for `whole_graph`.

The counts are those of src/native/estimate/sight.cpp, of a batch at once; their reasons stay behind.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cabinpose.estimate import sight
from cabinpose.estimate.settings import ViewSettings

_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # powers of u and v in the surface
_RIDGE = 1e-6
_GREATEST = 3.402823466e38  # of float32


class Sight(nn.Module):
    """Whether there is nobody to be seen in frames, as a trace of one size of view has it."""

    def __init__(self, settings: ViewSettings) -> None:
        super().__init__()
        height, width = settings.view.height, settings.view.width
        self._every = sight.looked_at_every(height)
        self._rows, self._columns = -(-height // self._every), -(-width // self._every)
        self._border = (0, self._columns * self._every - width, 0, self._rows * self._every - height)
        scale = max(self._rows, self._columns)
        v, u = (torch.arange(n, dtype=torch.float64) / scale - 0.5 for n in (self._rows, self._columns))
        # (6, rows, columns): what each term of the surface is at a block.
        self._terms = torch.stack([u**a * v[:, None] ** b for a, b in _TERMS])
        before = torch.arange(self._columns)
        self._is_before = before < before[:, None]  # (columns, columns): block k stands before block j in its row

    def forward(self, filled: Tensor, depth: Tensor, amplitude: Tensor | None = None) -> Tensor:
        """(N,) bool, of the share of the view that the camera fills, a scalar, depths (N, h, w) m, 0 = invalid, amplitudes."""
        z = depth[:, :: self._every, :: self._every]
        there = z > 0
        found, pair = _count(there), there[..., 1:] & there[..., :-1]
        steps = pair & ((z[..., 1:] - z[..., :-1]).abs() > sight.STEP * z[..., :-1])
        share = found / torch.clamp(self._rows * self._columns * filled, min=1.0)
        full = (share > sight.MANY) & (found > sight.FEWEST_PIXELS)
        valid = depth > 0
        scattered = _count(valid[..., 1:] & valid[..., :-1]) < sight.FEWEST_JOINED * _count(valid)
        none = (
            (share < sight.FEWEST_VALID)
            | (_count(there & (z < sight.COVERED_M)) > 0.5 * found)
            | (_count(there & (z < sight.CLOSED_M)) > sight.ALL * found)
            | (_count(steps) > sight.ROUGH * torch.clamp(_count(pair), min=1.0))
            | (full & self._shapeless(depth))
            | (~full & scattered)
        )
        if amplitude is None:
            return none
        fine = (amplitude * depth * depth > sight.DARKEST) & (amplitude <= _GREATEST)  # NaN is neither
        lit = _count(there & (amplitude[:, :: self._every, :: self._every] > 0))
        return none | (_count(~fine) > 0) | (lit < sight.LEAST_LIT * found)

    def _shapeless(self, depth: Tensor) -> Tensor:
        """(N,) whether the mean depths of blocks have no silhouette, or lie on one surface 1/z = a + b u + c v + ..."""
        sums, known = self._summed(depth), self._summed((depth > 0).float())
        there = known > 0
        mean = torch.where(there, sums / torch.clamp(known, min=1.0), 0.0)  # (N, rows, columns)
        place = torch.arange(self._columns)
        last = torch.where(self._is_before & there[..., None, :], place, -1).amax(
            -1
        )  # of the blocks before, the last with a depth
        before = mean.gather(-1, last.clamp(min=0))
        both = there & (last >= 0)
        edges = both & ((mean - before).abs() > sight.EDGE * before)
        z = mean.double()
        inverse = torch.where(there, 1.0 / torch.where(there, z, 1.0), 0.0)
        weighted = there.double()[:, None] * self._terms  # (N, 6, rows, columns)
        normal = torch.einsum("ntrc,src->nts", weighted, self._terms)
        right = torch.einsum("nrc,trc->nt", inverse, self._terms)
        surface = torch.einsum("nt,trc->nrc", _solved(normal, right), self._terms)
        off = there & ((surface * z - 1.0).abs() > sight.OFF_SURFACE)
        return (_count(edges) < sight.FEWEST_EDGES * _count(both)) | (_count(off) < sight.FLAT * _count(there))

    def _summed(self, image: Tensor) -> Tensor:
        """(N, rows, columns) the sums over blocks; those at the right and at the bottom may be smaller."""
        padded = nn.functional.pad(image, self._border)
        return padded.reshape(-1, self._rows, self._every, self._columns, self._every).sum((2, 4))


def _count(which: Tensor) -> Tensor:
    """(N,) how many of (N, ..., ...) there are, as a number that shares are taken of."""
    return which.double().sum((1, 2))


def _solved(a: Tensor, b: Tensor) -> Tensor:
    """(N, 6) the solution of symmetric, positive definite systems (N, 6, 6), after Cholesky: ONNX has no operator that solves."""
    count = len(_TERMS)
    lower: dict[tuple[int, int], Tensor] = {}
    x: dict[int, Tensor] = {}
    for j in range(count):
        for i in range(j, count):
            rest = a[:, i, j] + (_RIDGE if i == j else 0.0) - sum(lower[i, k] * lower[j, k] for k in range(j))
            lower[i, j] = rest.sqrt() if i == j else rest / lower[j, j]
    for i in range(count):
        x[i] = (b[:, i] - sum(lower[i, k] * x[k] for k in range(i))) / lower[i, i]
    for i in reversed(range(count)):
        x[i] = (x[i] - sum(lower[k, i] * x[k] for k in range(i + 1, count))) / lower[i, i]
    return torch.stack([x[i] for i in range(count)], dim=-1)
