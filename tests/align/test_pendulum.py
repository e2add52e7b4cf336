"""The marker's centre in rendered blobs whose truth is known: pixels are integrals of a closed form over their area."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from cabinpose.align.pendulum import brightest_blob

SHAPE = (40, 50)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


def _gaussian(centre: np.ndarray, sigma: float) -> np.ndarray:
    """A Gaussian of height 1, integrated over each pixel."""

    def one(x: np.ndarray, c: float) -> np.ndarray:
        edges = [erf((x + s - c) / (sigma * np.sqrt(2))) for s in (-0.5, 0.5)]
        return (edges[1] - edges[0]) * sigma * np.sqrt(np.pi / 2)

    return one(U, centre[0]) * one(V, centre[1])


def _disc(centre: np.ndarray, radius: float) -> np.ndarray:
    """A disc of height 1: the part of each pixel that it covers."""
    share = (np.arange(16) + 0.5) / 16 - 0.5
    u, v = U[..., None, None] + share[:, None] - centre[0], V[..., None, None] + share - centre[1]
    return (np.hypot(u, v) <= radius).mean(axis=(2, 3))


def _errors(render, noise: float = 0.0, count: int = 40) -> np.ndarray:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(1)
    centres = rng.uniform((18, 15), (31, 26), (count, 2))
    images = [np.clip(np.round(100 + render(c) + rng.normal(scale=noise, size=SHAPE)), 0, 4095) for c in centres]
    return np.linalg.norm([brightest_blob(image) - c for image, c in zip(images, centres, strict=True)], axis=1)


@pytest.mark.parametrize("noise", [0.0, 8.0])
@pytest.mark.parametrize(
    ("sigma", "height", "least"),
    [(1.0, 3900, 0.008), (1.0, 8000, 0.015), (1.0, 40_000, 0.022), (2.5, 3900, 0.006), (2.5, 40_000, 0.012)],
)
def test_clipped_and_whole_gaussians(sigma: float, height: float, least: float, noise: float):
    errors = _errors(lambda c: height * _gaussian(c, sigma), noise)
    assert np.sqrt(np.mean(errors**2)) < least


@pytest.mark.parametrize(
    ("radius", "height", "least"),
    [(1.0, 3900, 0.035), (2.5, 3900, 0.01), (6.0, 3900, 0.005), (1.0, 8000, 0.075), (1.5, 8000, 0.065), (6.0, 8000, 0.05)],
)
def test_discs_up_to_twice_too_bright(radius: float, height: float, least: float):
    """At twice what a pixel holds, a pixel half covered is clipped like a whole one: what is known of the edge is lost."""
    errors = _errors(lambda c: height * _disc(c, radius), 8.0, 25)
    assert np.sqrt(np.mean(errors**2)) < least


def test_the_brightest_pixel_alone_would_be_off_by_more():
    """What the centroid is for: the thesis' argmax is wrong by half a blob once that is clipped."""
    centre = np.array((25.3, 20.4))
    image = np.minimum(100 + 40_000 * _gaussian(centre, 2.5), 4095)
    v, u = np.unravel_index(np.argmax(image), SHAPE)
    assert np.hypot(u - centre[0], v - centre[1]) > 3
    assert np.linalg.norm(brightest_blob(image) - centre) < 0.02


@pytest.mark.parametrize("lost", [0.0, np.nan])
def test_clipped_pixels_that_are_delivered_dark_or_not_at_all(lost: float):
    for c in np.random.default_rng(2).uniform((18, 15), (31, 26), (20, 2)):
        image = 100 + 40_000 * _gaussian(c, 2.0)
        image = np.where(image > 20_000, lost, image)
        assert np.linalg.norm(brightest_blob(image) - c) < 0.02


def test_a_bright_wall_beside_the_marker_does_not_draw_it():
    """A slope of the background of 5 a pixel below a blob of 3900."""
    centre = np.array((24.7, 19.6))
    image = np.minimum(100 + 5 * U + 40_000 * _gaussian(centre, 1.5), 4000)
    assert np.linalg.norm(brightest_blob(image) - centre) < 0.1


def _scene(*blobs: tuple[float, float, float, float]) -> np.ndarray:
    rng = np.random.default_rng(3)
    image = 100 + rng.normal(scale=8, size=SHAPE)
    for u, v, sigma, height in blobs:
        image += height * _gaussian(np.array((u, v)), sigma)
    return np.clip(np.round(image), 0, 4095).astype(np.uint16)


def test_a_fainter_reflection_is_not_the_marker():
    found = brightest_blob(_scene((12.0, 10.0, 1.5, 3900.0), (36.0, 30.0, 1.5, 1500.0)))
    assert np.linalg.norm(found - (12, 10)) < 0.02


@pytest.mark.parametrize(
    "image",
    [
        _scene(),  # noise alone
        _scene((20.0, 20.0, 1.5, 120.0)),  # too faint
        _scene((12.0, 10.0, 1.5, 3900.0), (36.0, 30.0, 1.5, 3500.0)),  # two of them
        _scene((12.0, 10.0, 2.0, 9000.0), (36.0, 30.0, 2.0, 9000.0)),  # two, both clipped
        _scene((25.0, 20.0, 9.0, 9000.0)),  # as large as a hand
        _scene((25.0, 20.0, 0.1, 90_000.0)),  # one hot pixel
        np.zeros(SHAPE),
        np.full(SHAPE, 4095.0),
        np.full(SHAPE, np.nan),
    ],
)
def test_no_marker_or_two_is_told(image: np.ndarray):
    assert np.isnan(brightest_blob(image)).all()
