"""People as populations have them: drawn as published, and bodies that measure what was asked of them."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from trimesh.intersections import mesh_plane

from cabinpose.core.errors import ConfigError
from cabinpose.scene.body import (
    BONES,
    DIMENSIONS,
    DOF_INDEX,
    DOFS,
    SEGMENTS,
    SUBJECTS,
    BodyModel,
    Person,
    Phenotype,
    load_population,
    usual_stature_m,
)
from cabinpose.scene.body import phenotype as phenotypes
from cabinpose.scene.body.fitting import BODY_DENSITY, VOLUMES, tabulate_volumes
from cabinpose.scene.body.populations import Anthropometry, read_population
from cabinpose.synth import subject_body
from cabinpose.synth.config import SynthConfig

# Mean, SD, 5th, 50th and 95th percentiles (cm, kg) of NHANES 2017-2018, adults from 20 years, and of ANSUR II, as published.
PUBLISHED = {
    ("nhanes", "male"): ((175.2, 7.4, 163.3, 175.3, 187.6), (91.5, 22.0, 61.7, 88.9, 131.6)),
    ("nhanes", "female"): ((161.0, 6.9, 150.2, 161.0, 172.5), (77.6, 21.9, 49.7, 73.2, 119.6)),
    ("ansur", "male"): ((175.62, 6.86, 164.8, 175.5, 187.0), (85.5, 14.2, 64.4, 84.6, 110.7)),
    ("ansur", "female"): ((162.85, 6.42, 152.5, 162.6, 174.0), (67.8, 11.0, 51.3, 66.8, 87.1)),
}
ANSUR_SITTING_HEIGHT_CM = {"male": (91.83, 3.57), "female": (85.66, 3.31)}
DRAWS = 2500
DATA = Path(os.environ.get("CABINPOSE_REAL_DATA", "missing")) / "populations"


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


@pytest.mark.parametrize(("name", "sex"), PUBLISHED)
def test_stature_and_mass_are_distributed_as_published(name: str, sex: str) -> None:
    """Within what the issue of it allows, 2 % and 5 %, and what so few draws are off by themselves: 3 SDs of a sample's SD."""
    years = (20.0, 81.0) if name == "nhanes" else (17.0, 59.0)
    generator = rng()
    people = [load_population(name).draw(rng=generator, sex=sex, years=years) for _ in range(DRAWS)]
    measured = (np.array([100 * p.stature_m for p in people]), np.array([p.mass_kg for p in people]))
    for values, published, allowed in zip(measured, PUBLISHED[name, sex], (0.02, 0.05), strict=True):
        drawn = np.array([values.mean(), values.std(), *np.percentile(values, (5, 50, 95))])
        slack = np.array([0.005, 3 / np.sqrt(2 * DRAWS), 0.01, 0.01, 0.02])
        assert (abs(drawn / published - 1) < allowed + slack).all(), drawn
    if name == "ansur":
        sitting = np.array([100 * p["sitting_height"] for p in people])
        assert_allclose((sitting.mean(), sitting.std()), ANSUR_SITTING_HEIGHT_CM[sex], rtol=0.06, atol=0.3)


@pytest.mark.skipif(not DATA.is_dir(), reason="CABINPOSE_REAL_DATA has no populations")
def test_packaged_percentiles_are_those_of_the_source() -> None:
    with (DATA / "nhanes_2017_2018_stats.csv").open() as stream:
        group = [row for row in csv.DictReader(stream) if row["age_group"] == "30-39"]
    rows = [row for row in group if row["measure"] in ("stature_cm", "mass_kg")]
    assert len(rows) == 4
    for row in rows:
        sex = {"M": "male", "F": "female"}[row["sex"]]
        (band,) = (b for b in load_population("nhanes").bands if b.sex == sex and b.years == (30.0, 40.0))
        values = band.stature_m * 100 if row["measure"] == "stature_cm" else band.mass_kg
        assert_allclose(values[[1, 3, 4, 5, 7]], [float(row[p]) for p in ("p5", "p25", "p50", "p75", "p95")], rtol=1e-3)


def test_growth_is_that_of_the_charts() -> None:
    """CDC 2000: medians at 18 years."""
    age = phenotypes.age_of(18.0)
    assert_allclose([usual_stature_m(gender, age)[0] for gender in (0.0, 1.0)], (1.762, 1.631), atol=2e-3)
    child = load_population("cdc").of_percentile("male", 50, 3.0)
    assert_allclose((child.stature_m, child.mass_kg), (0.950, 14.3), rtol=5e-3)


def body(size: Anthropometry, seed: int = 1) -> Person:
    return BodyModel.load().person(Phenotype.of_size(size, rng=rng(seed)))


# Medians of CDC 2000 at 0, 3, 6, 12, 24 and 36 months: length (from two years stature), mass, head
# circumference, cm and kg.
INFANTS = {
    "male": ((50.0, 60.8, 67.0, 75.5, 86.5, 95.0), (3.5, 6.0, 7.9, 10.3, 12.7, 14.3), (35.8, 41.2, 43.7, 46.3, 48.7, 49.7)),
    "female": ((49.3, 59.3, 65.3, 73.8, 85.0, 93.9), (3.4, 5.5, 7.2, 9.5, 12.1, 13.9), (34.7, 39.9, 42.4, 45.0, 47.5, 48.6)),
}
INFANT_YEARS = (0.0, 0.25, 0.5, 1.0, 2.0, 3.0)
SITTING_SHARE = (0.69, 0.68, 0.67, 0.65, 0.60, 0.57)  # of the length: medians of the Dutch growth study


def by_hand(person: Person, brow_m: tuple[float, ...] = ()) -> dict[str, float]:
    """Some dimensions by other means than the package's: trimesh on the whole posed skin."""
    standing, sitting = np.zeros(len(DOFS)), np.zeros(len(DOFS))
    sitting[[DOF_INDEX[s + joint] for s in "lr" for joint in ("hip.flexion", "knee.flexion", "elbow.flexion")]] = np.pi / 2
    lean, leaning = np.radians(15.0), np.eye(4)  # of the pelvis, sitting erect: Lord 1997
    sitting[[DOF_INDEX["lhip.flexion"], DOF_INDEX["rhip.flexion"]]] -= lean
    sitting[DOF_INDEX["lumbar.flexion"]] = lean
    leaning[:3, :3] = Rotation.from_euler("y", -lean).as_matrix()
    up, sat = (person.pose(q, root) for q, root in ((standing, np.eye(4)), (sitting, leaning)))
    mesh, seated = (trimesh.Trimesh(p.skin, person.skin_faces, process=False) for p in (up, sat))
    size, eyes = person.stature_m / 1.75, up.eyes_m[2]
    x, knee = sat.skin[:, 0], sat.bones[BONES.index("lshank"), 0, 3]
    legs = np.isin(person.skin_segment, [SEGMENTS.index(name) for name in ("pelvis", "lthigh", "rthigh", "lshin")])
    brow = brow_m or (0.03 * size, 0.04 * size, 0.05 * size)
    rings = (mesh_plane(mesh, [0, 0, 1], [0, 0, eyes + h]).reshape(-1, 3) for h in brow)
    left_hand = up.skin[person.skin_segment == SEGMENTS.index("lhand")]
    return {
        "stature": float(np.ptp(mesh.bounds[:, 2])),
        "sitting_height": float(seated.bounds[1, 2] - sat.skin[legs & (x < 0.15 * size), 2].min()) - 0.02 * person.stature_m,
        "knee_height_sitting": float(sat.skin[legs & (x > knee + 0.015), 2].max() - seated.bounds[0, 2]),
        "head_circumference": max(float(ConvexHull(ring[:, :2]).area) for ring in rings),
        "hand_length": float(np.linalg.norm(left_hand - up.bones[BONES.index("lhand"), :3, 3], axis=1).max()),
    }


@pytest.mark.parametrize("sex", INFANTS)
@pytest.mark.parametrize("row", range(len(INFANT_YEARS)))
def test_infants_and_toddlers_measure_the_published_medians(sex: str, row: int) -> None:
    person = BodyModel.load().person(
        Phenotype.of_size(load_population("cdc").of_percentile(sex, 50.0, INFANT_YEARS[row]), rng=None)
    )
    found = by_hand(person, brow_m=tuple(np.arange(0.01, 0.04, 0.006)))
    length, mass, head = (values[row] for values in INFANTS[sex])
    assert found["stature"] == pytest.approx(length / 100, rel=0.02)
    assert found["head_circumference"] == pytest.approx(head / 100, rel=0.05)
    assert found["sitting_height"] == pytest.approx(SITTING_SHARE[row] * length / 100, rel=0.05)
    mesh = trimesh.Trimesh(person.rest_skin, person.skin_faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume * BODY_DENSITY == pytest.approx(mass, rel=0.05)


@pytest.mark.parametrize("name", ["nhanes_male_p5", "nhanes_female_p95", "ansur_male_p50", "cdc_female_6y_p50"])
def test_bodies_measure_what_was_asked(name: str) -> None:
    size = SUBJECTS[name].phenotype.size
    person = BodyModel.load().person(SUBJECTS[name].phenotype)
    asked = {"stature": size.stature_m} | {dimension: size[dimension] for dimension in DIMENSIONS}
    for dimension, value in asked.items():
        assert person.dimensions_m[dimension] == pytest.approx(value, rel=0.03), dimension
    for dimension, value in by_hand(person).items():
        assert asked[dimension] == pytest.approx(value, rel=0.03), dimension
    mesh = trimesh.Trimesh(person.rest_skin, person.skin_faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume * BODY_DENSITY == pytest.approx(size.mass_kg, rel=0.02)
    assert person.stature_m == size.stature_m


def test_joints_go_with_the_segments() -> None:
    """A longer forearm: from its elbow to its wrist, and the skin with both; upper arm and other side as they were."""
    size = SUBJECTS["nhanes_female_p50"].phenotype.size
    at = list(DIMENSIONS).index("radiale_stylion_length")
    longer = replace(size, dimensions_m=(*size.dimensions_m[:at], 1.1 * size.dimensions_m[at], *size.dimensions_m[at + 1 :]))
    one, other = (body(s) for s in (size, longer))
    assert other.segment_lengths["forearm"] / one.segment_lengths["forearm"] == pytest.approx(1.1, rel=0.01)
    assert other.segment_lengths["upper_arm"] == pytest.approx(one.segment_lengths["upper_arm"], rel=0.01)
    reach = [np.ptp(p.rest_skin[:, 1]) for p in (one, other)]
    assert reach[1] - reach[0] > 0.02


def test_a_crowd_is_of_men_and_women_and_only_men_have_beards() -> None:
    config = SynthConfig.parse({"people": {"subjects": [], "random": {"count": 150}}})
    people = [subject_body(config, 3, name) for name in config.people.names]
    genders = np.array([phenotype.gender for phenotype, _ in people])
    assert not ((genders > 0.2) & (genders < 0.8)).any()
    assert 0.35 < (genders > 0.5).mean() < 0.65
    assert not any(outfit.beard for phenotype, outfit in people if phenotype.size.sex == "female")
    assert any(outfit.beard for _, outfit in people)
    assert 27.0 < np.mean([phenotype.size.bmi for phenotype, _ in people]) < 32.0  # NHANES: 29.7 and 29.9
    assert {phenotype.size.population for phenotype, _ in people} == {"nhanes"}
    assert min(phenotype.years for phenotype, _ in people) >= 18.0


def crowd(**random: object) -> list[Phenotype]:
    config = SynthConfig.parse({"people": {"subjects": [], "random": {"count": 12, **random}}})
    return [subject_body(config, 3, name)[0] for name in config.people.names]


def test_ranges_of_a_population_and_of_shapes() -> None:
    women = crowd(population="ansur", ranges={"gender": {"min": 1, "max": 1}, "stature_cm": {"min": 165, "max": 170}})
    assert all(p.size.sex == "female" and 1.65 <= p.size.stature_m <= 1.70 and p.size.population == "ansur" for p in women)
    assert all(p.size is None for p in crowd(ranges={"weight": {"min": 0.4, "max": 0.5}}))
    assert all(p.size is None for p in crowd(population="evenly"))
    with pytest.raises(ConfigError, match="weight"):
        crowd(population="nhanes", ranges={"weight": {"min": 0.4, "max": 0.5}})
    with pytest.raises(ConfigError, match="nobody of 70"):
        crowd(population="ansur", ranges={"years": {"min": 70, "max": 75}})


BANDS = """sex,years_from,years_to,measure,unit,mean,sd
female,18,65,stature,cm,164,6.5
female,18,65,mass,kg,66,11
"""


def test_a_teams_own_population(tmp_path: Path) -> None:
    (tmp_path / "ours.csv").write_text(BANDS)
    config = SynthConfig.parse({"people": {"subjects": [], "random": {"count": 60, "population": "ours.csv"}}}, base=tmp_path)
    sizes = [subject_body(config, 0, name)[0].size for name in config.people.names]
    assert {size.sex for size in sizes} == {"female"}
    assert np.mean([size.mass_kg for size in sizes]) == pytest.approx(66, rel=0.06)
    assert np.mean([size.stature_m for size in sizes]) == pytest.approx(1.64, rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "right", "told"),
    [
        ("164", "tall", "line 2: mean is 'tall'"), ("female,18,65,mass", "woman,18,65,mass", "line 3: unknown sex 'woman'"),
        (",cm,", ",feet,", "unknown unit of stature 'feet'"), ("mass,kg", "weight,kg", "unknown measure 'weight'"),
        ("years_to", "to", "no column years_to"), ("18,65,mass", "20,65,mass", "has no mass of female people of 18 to 65 years"),
        ("18,65", "65,18", "people of 65 to 18 years"), ("66,11", "66,110", "an SD of 110"),
        ("stature,cm", "stature,m", "female people of 18 to 65 years are 164 m tall"),
        ("stature,cm", "stature,mm", "0.164 m tall"),
        ("mass,kg", "mass,lb", "weigh 29.5 kg"), ("mean,sd\n", "mean,sd\n\nman,18,65,stature,cm,175,7\n", "line 3: unknown sex"),
        ("mean,sd\n", "mean,sd,p3,p97\n", "column p3, p97 is not taken"),
        ("mean,sd\n", "mean,sd,p05,P95,p2.5\n", "column p05, P95, p2.5 is not taken"),
    ],
)  # fmt: skip
def test_what_is_no_population_is_told(tmp_path: Path, wrong: str, right: str, told: str) -> None:
    path = tmp_path / "ours.csv"
    path.write_text(BANDS.replace(wrong, right))
    with pytest.raises(ConfigError, match=told) as caught:
        load_population(str(path))
    assert caught.value.hint


OF_BOTH = """sex,years_from,years_to,share,measure,unit,mean,sd,r_with_stature
female,18,40,,stature,cm,164,6.5,0.7
female,18,40,0.3,mass,kg,66,11,
female,40,65,0.7,stature,cm,164,6.5,
female,40,65,0.7,mass,kg,66,11,0.2
"""


def test_share_and_correlation_count_in_either_row(tmp_path: Path) -> None:
    path = tmp_path / "ours.csv"
    path.write_text(OF_BOTH)
    assert [(band.share, band.r) for band in read_population("ours", path).bands] == [(0.3, 0.7), (0.7, 0.2)]
    path.write_text(OF_BOTH.replace("40,65,0.7,mass", "40,65,0.8,mass"))
    with pytest.raises(ConfigError, match="40 to 65 years have two values of share"):
        read_population("ours", path)
    path.write_text(OF_BOTH.replace("6.5,\n", "6.5,0.5\n"))
    with pytest.raises(ConfigError, match="40 to 65 years have two values of r_with_stature"):
        read_population("ours", path)


CURVE = """sex,years,measure,unit,L,M,S
female,6,stature,cm,1,115,0.04
female,6,mass,kg,-1,20,0.12
female,8,stature,cm,1,127,0.04
female,8,mass,kg,-1,26,0.12
"""


def test_a_curve_of_one_sex(tmp_path: Path) -> None:
    path = tmp_path / "girls.csv"
    path.write_text(CURVE)
    girls = read_population("girls", path)
    drawn = [girls.draw(rng=np.random.default_rng(i)) for i in range(40)]
    assert {one.sex for one in drawn} == {"female"}
    assert 6.0 <= min(one.years for one in drawn) < max(one.years for one in drawn) <= 8.0
    with pytest.raises(ConfigError, match="population girls has no male people"):
        girls.draw(rng=np.random.default_rng(0), sex="male")
    path.write_text("\n".join(CURVE.splitlines()[:3]))
    with pytest.raises(ConfigError, match="one age of female people"):
        read_population("girls", path)


def test_the_table_of_volumes_is_of_these_bodies() -> None:
    """A newer body asset needs `tools/make_populations.py` again."""
    packaged = np.load(Path(phenotypes.__file__).parent / "assets" / VOLUMES)
    assert_allclose(tabulate_volumes(only=(0, 3, 1)), packaged[0, 3, 1], atol=1e-3)
