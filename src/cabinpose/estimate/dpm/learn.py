"""The structured support vector machine: block-coordinate Frank–Wolfe in the dual, one block an example.

min ½ |w − w₀|² + C Σ_i max(0, max_y Δ_i(y) + w·(Φ_i(y) − Φ_i(y_i)))    (Tsochantaridis et al. 2005, margin rescaling)

Every step is an exact line search of the dual towards one answer of one example, so that there is no rate to tune and the
difference of primal and dual tells how far the optimum is (Lacoste-Julien et al. 2013, algorithm 4). Answers that were found
stay: searching a frame is a hundred times dearer than a step (the cache of hard negatives of Felzenszwalb et al. 2010).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.dpm.hog import F32


class Answer(NamedTuple):
    """Φ(y) of an answer: types (P,) and what each part shows, rows (P, K); empty for nobody. loss: Δ(y)."""

    types: NDArray[np.int64]
    rows: NDArray[np.floating]
    loss: float


def nobody(loss: float) -> Answer:
    """The answer that nobody is there."""
    return Answer(np.zeros(0, np.int64), np.zeros((0, 0), np.float32), loss)


class StructuredSvm:
    """Weights of parts (P, T, K), and the dual variables of N examples with the answers that were found for each."""

    def __init__(self, start: F32, truths: list[Answer], cost: float) -> None:
        """start: w₀ (P, T, K) · truths: the right answer of each example · cost: C."""
        self._start = start.astype(np.float64)
        self.weights = self._start.copy()
        self._truths, self._cost = truths, cost
        self._own = np.zeros((len(truths), *start.shape), np.float32)  # w − w₀ is their sum
        self._level = np.zeros(len(truths))  # ℓ_i of the dual
        self.answers: list[list[Answer]] = [[] for _ in truths]

    def violation(self, example: int, answer: Answer) -> float:
        """Δ(y) + w·(Φ(y) − Φ(y_i)): what an answer costs now, at C = 1."""
        return answer.loss + _score(self.weights, answer) - _score(self.weights, self._truths[example])

    def add(self, example: int, answer: Answer) -> None:
        """Take an answer that a search has found, and learn from it."""
        self.answers[example].append(answer._replace(rows=answer.rows.astype(np.float16)))
        self._step(example, self.answers[example][-1])

    def sweep(self, order: NDArray[np.int64]) -> None:
        """A step for each example, towards the worst of its answers, or away from all."""
        for example in order.tolist():
            if found := self.answers[example]:
                costs = [self.violation(example, answer) for answer in found]
                self._step(example, found[int(np.argmax(costs))] if max(costs) > 0 else self._truths[example])

    def objective(self) -> tuple[float, float]:
        """Primal, over the answers found so far, and dual: the optimum lies between them."""
        length = 0.5 * float(np.square(self.weights - self._start).sum())
        hinge = sum(max([0.0, *(self.violation(i, a) for a in found)]) for i, found in enumerate(self.answers))
        return length + self._cost * hinge, float(self._level.sum()) - length

    def forget(self, most: int) -> None:
        """Keep the worst answers of each example, at most so many."""
        for example, found in enumerate(self.answers):
            self.answers[example] = sorted(found, key=lambda a: self.violation(example, a))[-most:]

    def _step(self, example: int, answer: Answer) -> None:
        truth, own, start = self._truths[example], self._own[example], self._start
        towards = np.zeros_like(own)
        _accumulate(towards, answer, -self._cost)
        _accumulate(towards, truth, self._cost)
        loss = 0.0 if answer is truth else answer.loss
        level = self._cost * (loss + _score(start, answer) - _score(start, truth))
        apart = own - towards
        square = float(np.vdot(apart, apart))
        if square <= 0:
            return
        slope = float(np.vdot(apart, (self.weights - start).astype(np.float32))) - self._level[example] + level
        step = min(max(slope / square, 0.0), 1.0)
        self.weights -= step * apart
        own -= np.float32(step) * apart
        self._level[example] += step * (level - self._level[example])


def _score(weights: NDArray[np.floating], answer: Answer) -> float:
    if not len(answer.types):
        return 0.0
    mine = weights[np.arange(len(answer.types)), answer.types]
    return float(np.einsum("pk,pk->", mine, answer.rows.astype(np.float64)))


def _accumulate(into: F32, answer: Answer, factor: float) -> None:
    if len(answer.types):
        into[np.arange(len(answer.types)), answer.types] += np.float32(factor) * answer.rows.astype(np.float32)
