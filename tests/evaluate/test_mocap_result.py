"""The numbers about errors: closed forms, and intervals that hold the truth as often as they say."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core.errors import ConfigError
from cabinpose.evaluate.mocap.result import ALL, Errors, block_length, correlation_time, summarise


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=seed))


def run(values: np.ndarray, condition: str = "a", step_s: float = 0.1, names: tuple[str, ...] | None = None) -> Errors:
    values = np.asarray(values, float)
    names = names or tuple(f"n{i}" for i in range(values.shape[1]))
    return Errors("m", "m", condition, names, np.arange(len(values)) * step_s, values)


def first_order(count: int, rho: float, generator: np.random.Generator) -> np.ndarray:
    x = np.empty(count)
    x[0] = generator.normal()
    noise = generator.normal(0, np.sqrt(1 - rho**2), count)
    for i in range(1, count):
        x[i] = rho * x[i - 1] + noise[i]
    return x


def test_numbers_are_those_of_all_known_errors_in_millimetres() -> None:
    a = np.array([[0.001, 0.010], [0.003, np.nan], [0.005, 0.030]])
    rows = {(s.condition, s.name): s for s in summarise([run(a), run(a[:1] + 0.1, "b")], rng=rng(), resamples=0)}
    one = rows["a", "n0"]
    assert (one.samples, one.unit) == (3, "mm")
    assert [one.mean, one.sd, one.median, one.maximum] == pytest.approx([3, 2, 3, 5])
    assert np.isnan(one.mean_low)
    assert rows["a", ALL].samples == 5
    assert rows["a", ALL].mean == pytest.approx((1 + 3 + 5 + 10 + 30) / 5)
    assert rows[ALL, ALL].samples == 7
    assert rows[ALL, "n1"].maximum == pytest.approx(110)
    assert one.box == pytest.approx(np.quantile([1, 3, 5], (0.05, 0.25, 0.5, 0.75, 0.95)))


def test_names_that_a_run_lacks_are_unknown_there() -> None:
    rows = summarise([run([[1.0]], names=("x",)), run([[2.0]], "b", names=("y",))], rng=rng(), resamples=0)
    found = {(s.condition, s.name): s.samples for s in rows}
    assert found["a", "x"] == 1
    assert ("a", "y") not in found
    assert found[ALL, "y"] == 1


def test_correlation_time_of_first_order_noise_is_its_own() -> None:
    times = [correlation_time(first_order(4000, np.exp(-0.1 / 2.0), rng(k))[:, None], 0.1) for k in range(12)]
    assert np.mean(times) == pytest.approx(2.0, rel=0.15)
    assert correlation_time(rng().normal(size=(4000, 3)), 0.1) < 0.1
    assert correlation_time(np.ones((50, 2)), 0.1) == 0.1


def test_blocks_follow_carlsteins_rule() -> None:
    noise = run(first_order(3000, np.exp(-0.1 / 2.0), rng(5))[:, None])
    tau = correlation_time(noise.values, 0.1)
    assert block_length(noise) == pytest.approx(tau ** (2 / 3) * 300 ** (1 / 3))
    assert block_length(run(np.ones((3, 1)))) == pytest.approx((0.1) ** (2 / 3) * 0.3 ** (1 / 3))


def test_intervals_hold_the_mean_of_noise_that_remembers() -> None:
    """Errors with a memory of 20 frames: blocks hold the mean 0 nine times in ten; frames drawn one by one do not."""
    held = {None: 0, 0.1: 0}
    for k in range(40):
        noise = run(first_order(800, np.exp(-1 / 20), rng(k))[:, None])
        for block_s in held:
            row = summarise([noise], rng=rng(100 + k), resamples=100, block_s=block_s)[0]
            held[block_s] += row.mean_low <= 0 <= row.mean_high
    assert held[None] >= 32  # 95 % of 40 are 38; the blocks' own bias is some per cent
    assert held[0.1] <= 20


def test_few_blocks_give_no_interval() -> None:
    rows = summarise([run(rng().normal(size=(40, 1)))], rng=rng(), block_s=1.0)
    assert np.isnan(rows[0].mean_low)
    rows = summarise([run(rng().normal(size=(50, 1)))], rng=rng(), block_s=1.0)
    assert rows[0].mean_low < rows[0].mean < rows[0].mean_high
    assert rows[0].median_low <= rows[0].median <= rows[0].median_high
    assert rows[0].block_s == 1.0


def test_equal_seeds_give_equal_intervals() -> None:
    values = rng().normal(size=(200, 2))
    assert summarise([run(values)], rng=rng(3)) == summarise([run(values)], rng=rng(3))


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="positive block"):
        summarise([run([[1.0]])], rng=rng(), block_s=0.0)
