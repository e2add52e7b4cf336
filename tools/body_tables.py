"""Print the tables of docs/populations.md and docs/joints.md from the tree as it is.

    python tools/body_tables.py [TABLE ...] [--scale SHARE]

Tables, each of Markdown, with what is beyond its limit in bold:

 draws      10 000 draws of each sex and age band of each population against what is published, the largest over bands
 bands      the same by band
 adults     300 bodies of adults, measured on their mesh against what was asked of each
 children   300 bodies from 3 to 17 years, likewise
 infants    median infants and toddlers of CDC 2000, measured on their mesh against what is published
 dummies    median children measured against crash dummies of the same age
 girths     circumferences, which are not asked for, of 60 men and 60 women of ANSUR II against its means
 reach      how many of a population are beyond what bodies can be
 joints     lengths between joints of 200 adults a sex, as shares of stature, against what is published
 child joints   the same of children
 hips       distance of the femur heads by stature
 plug-in gait   where Plug-in Gait has joints, from ours, of 100 adults a sex who sit with its markers on
 drivers    which share of the poses drawn for drivers of `nhanes` holds in a car, by body mass index, and who finds none

--scale: a share of the draws and bodies, to try it quickly.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from plug_in_gait import Wearer, joint_centres, seated
from scipy.spatial import ConvexHull
from trimesh import Trimesh
from trimesh.intersections import mesh_plane

from cabinpose.core import JOINTS
from cabinpose.scene.body import (
    BONE_INDEX,
    DIMENSIONS,
    DOFS,
    POPULATIONS,
    SEATED_YEARS,
    Anthropometry,
    BodyModel,
    Person,
    Phenotype,
    Sex,
    load_chart,
    load_population,
)
from cabinpose.synth import SynthConfig
from cabinpose.synth.car_scenes import CarScenes
from cabinpose.synth.plan import Plan
from cabinpose.synth.scene import Attempts
from cabinpose.synth.streams import frame_rng

Array = NDArray[np.float64]
LIMIT_PERCENT = {"stature": 2.0, "mass": 5.0}  # of draws
LIMIT_OF_BODIES_PERCENT = 3.0
PERCENTILES = (5, 50, 95)
FILES = Path(__file__).resolve().parents[1] / "src/cabinpose/scene/body/assets/populations"
SEED = 36
BMI_EDGES = (0, 20, 25, 30, 35, 40, 45)
# Means of ANSUR II (NATICK/TR-15/007), chest at the nipples, waist at the navel, buttocks, thigh and calf at their largest.
GIRTHS_MM = {
    "male": {"chest": 1058.7, "waist": 940.6, "buttocks": 1019.5, "thigh": 625.1, "calf": 392.3},
    "female": {"chest": 946.9, "waist": 860.9, "buttocks": 1021.2, "thigh": 616.1, "calf": 373.3},
}


INFANT_MONTHS = (0, 3, 6, 12, 24, 36)
# Medians of CDC 2000 at these ages: length (stature from two years), mass and head circumference, cm and kg.
INFANTS: dict[Sex, tuple[tuple[float, float, float], ...]] = {
    "male": ((50.0, 3.5, 35.8), (60.8, 6.0, 41.2), (67.0, 7.9, 43.7), (75.5, 10.3, 46.3), (86.5, 12.7, 48.7), (95.0, 14.3, 49.7)),
    "female": (
        (49.3, 3.4, 34.7),
        (59.3, 5.5, 39.9),
        (65.3, 7.2, 42.4),
        (73.8, 9.5, 45.0),
        (85.0, 12.1, 47.5),
        (93.9, 13.9, 48.6),
    ),
}
SITTING_SHARE = (0.69, 0.68, 0.67, 0.65, 0.60, 0.57)  # of the length: medians of the Dutch growth study, 3 months interpolated
# Years, mass (kg) and sitting height with the head tilted forward (mm) of the Q dummies (UN Regulation's dummy annex).
DUMMIES = {
    "Q0": (0.0, 3.47, 355.0), "Q1": (1.0, 9.6, 479.0), "Q1.5": (1.5, 11.1, 499.0), "Q3": (3.0, 14.59, 544.0),
    "Q6": (6.0, 22.95, 601.0), "Q10": (10.0, 35.58, 733.7),
}  # fmt: skip
LIMIT_OF_INFANTS_PERCENT = 5.0


def rng() -> np.random.Generator:
    """The same draws for every table."""
    return np.random.Generator(np.random.Philox(SEED))


def marked(value: float, limit: float, digits: int = 1) -> str:
    """A deviation in per cent, bold beyond its limit."""
    text = f"{value:.{digits}f}"
    return f"**{text}**" if abs(value) > limit else text


def published(population: str) -> Iterator[tuple[str, float, float, dict[str, list[float]]]]:
    """Sex, ages; mean and SD (of bands alone) and `PERCENTILES` of stature (cm) and mass (kg), as its file has them."""
    cells: dict[tuple[str, float, float], dict[str, list[float]]] = {}
    for row in csv.DictReader((FILES / f"{population}.csv").read_text("utf-8").splitlines()):
        if "L" in row:
            power, median, spread = (float(row[key]) for key in "LMS")
            values = [median * (1 + power * spread * NormalDist().inv_cdf(p / 100)) ** (1 / power) for p in PERCENTILES]
            years = (float(row["years"]), float(row["years"]))
        else:
            values = [float(row[key]) for key in ("mean", "sd", *(f"p{p}" for p in PERCENTILES))]
            years = (float(row["years_from"]), float(row["years_to"]))
        cells.setdefault((row["sex"], *years), {})[row["measure"]] = values
    for (sex, first, last), measures in cells.items():
        if first >= SEATED_YEARS and (first != last or first % 3 == 0 or first == SEATED_YEARS):
            yield sex, first, last, measures


def bands(scale: float) -> Iterator[tuple[str, str, str, dict[str, tuple[Array, Array]]]]:
    """Population, sex, years and what is published and drawn of each measure: mean, SD (of bands alone), percentiles."""
    for name in POPULATIONS:
        for sex, first, last, measures in published(name):
            generator, population = rng(), load_population(name)
            people = [population.draw(rng=generator, sex=sex, years=(first, last)) for _ in range(int(10_000 * scale))]
            sizes = {"stature": [100 * person.stature_m for person in people], "mass": [person.mass_kg for person in people]}
            both = {}
            for measure, values in sizes.items():
                drawn = np.array([np.mean(values), np.std(values), *np.percentile(values, PERCENTILES)])
                both[measure] = np.array(measures[measure]), drawn[-len(measures[measure]) :]
            yield name, sex, f"{first:g}" if last - first <= 1 else f"{first:g} to {last - 1:g}", both


def draws(scale: float) -> Iterator[list[str]]:
    """How far draws are from what is published, the largest over age bands."""
    yield ["population", "sex", "bands", *(f"{m}: {what}, %" for m in LIMIT_PERCENT for what in ("mean", "SD", "percentiles"))]
    found: dict[tuple[str, str], list[dict[str, Array]]] = {}
    for name, sex, _, both in bands(scale):
        off = {measure: 100 * (drawn / asked - 1) for measure, (asked, drawn) in both.items()}
        found.setdefault((name, sex), []).append(off)
    for (name, sex), off_bands in found.items():
        row = [name, sex, str(len(off_bands))]
        for measure, limit in LIMIT_PERCENT.items():
            off = np.array([one[measure] for one in off_bands])
            parts = (off[:, :0], off[:, :0], off) if off.shape[1] == len(PERCENTILES) else (off[:, :1], off[:, 1:2], off[:, 2:])
            row += [marked(part.flat[np.argmax(abs(part))], limit) if part.size else "" for part in parts]
        yield row


def draws_by_band(scale: float) -> Iterator[list[str]]:
    """The same by age band, with the numbers."""
    yield [
        "population",
        "sex",
        "years",
        *(f"{m}{what}" for m in ("stature, cm", "mass, kg") for what in ("", ": drawn", ": largest, %")),
    ]
    for name, sex, years, both in bands(scale):
        row = [name, sex, years]
        for measure, (asked, drawn) in both.items():
            off = 100 * (drawn / asked - 1)
            row += [", ".join(f"{x:.1f}" for x in values) for values in (asked, drawn)]
            row.append(marked(off[np.argmax(abs(off))], LIMIT_PERCENT[measure]))
        yield row


def bodies(years: tuple[float, float], scale: float, populations: tuple[str, ...]) -> Iterator[list[str]]:
    """Bodies measured on their mesh against what was asked, by dimension."""
    model, generator = BodyModel.load(), rng()
    errors = []
    for k in range(int(300 * scale)):
        size = load_population(populations[k % len(populations)]).draw(rng=generator, years=years)
        person = model.person(Phenotype.of_size(size, rng=generator))
        measured = person.dimensions_m
        asked = {"stature": size.stature_m} | dict(zip(DIMENSIONS, size.dimensions_m, strict=True))
        errors.append([*(100 * (measured[name] / asked[name] - 1) for name in asked), 100 * (person.mass_kg / size.mass_kg - 1)])
    off = np.array(errors)
    yield ["dimension", "mean, %", "largest, %", f"bodies beyond {LIMIT_OF_BODIES_PERCENT:g} %"]
    for name, column in zip(("stature", *DIMENSIONS, "mass"), off.T, strict=True):
        largest = column[np.argmax(abs(column))]
        beyond = np.count_nonzero(abs(column) > LIMIT_OF_BODIES_PERCENT)
        yield [
            name.replace("_", " "),
            f"{column.mean():.2f}",
            marked(largest, LIMIT_OF_BODIES_PERCENT),
            f"{beyond} of {len(off)}",
        ]


def infants(_: float) -> Iterator[list[str]]:
    """Median children from birth to three years, measured; sitting height against a share of the length."""
    yield [
        "sex",
        "months",
        *(f"{what}: published, ours, off %" for what in ("length, cm", "mass, kg", "head, cm", "sitting height, cm")),
    ]
    for sex, published in INFANTS.items():
        for month, sitting, (length, mass, head) in zip(INFANT_MONTHS, SITTING_SHARE, published, strict=True):
            person = median(sex, month / 12)
            at = person.dimensions_m
            pairs = (
                (length, 100 * at["stature"]), (mass, person.mass_kg), (head, 100 * at["head_circumference"]),
                (sitting * length, 100 * at["sitting_height"]),
            )  # fmt: skip
            off = [marked(100 * (ours / asked - 1), LIMIT_OF_INFANTS_PERCENT) for asked, ours in pairs]
            yield [sex, str(month), *(f"{p:.1f}, {o:.1f}, {d}" for (p, o), d in zip(pairs, off, strict=True))]


def dummies(_: float) -> Iterator[list[str]]:
    """The mean of a median boy and girl against dummies, which are as old as their names say."""
    yield ["dummy", "years", "mass, kg: dummy, ours", "off, %", "sitting height, mm: dummy, ours", "off, %"]
    for name, (years, mass, sitting) in DUMMIES.items():
        people = [median(sex, years) for sex in INFANTS]
        ours = np.mean([(p.mass_kg, 1000 * p.dimensions_m["sitting_height"]) for p in people], axis=0)
        off = 100 * (ours / (mass, sitting) - 1)
        mass_off, sitting_off = (marked(value, LIMIT_OF_INFANTS_PERCENT) for value in off)
        masses, heights = f"{mass:.2f}, {ours[0]:.2f}", f"{sitting:.0f}, {ours[1]:.0f}"
        yield [name, f"{years:g}", masses, mass_off, heights, sitting_off]


def median(sex: Sex, years: float) -> Person:
    """The median child of an age."""
    return BodyModel.load().person(Phenotype.of_size(load_population("cdc").of_percentile(sex, 50.0, years), rng=None))


def reach(scale: float) -> Iterator[list[str]]:
    """How many of each population are beyond what bodies can be."""
    yield ["population", "sex", "years", "brought to the limit, %"]
    for name, years in (("nhanes", (3.0, 18.0)), ("nhanes", (18.0, 81.0)), ("ansur", (17.0, 59.0)), ("cdc", (3.0, 20.0))):
        population = load_population(name)
        for sex in ("male", "female"):
            share = 100 * population.beyond_bodies(sex=sex, years=years, rng=rng(), draws=int(10_000 * scale))
            yield [name, sex, f"{years[0]:g} to {years[1]:g}", f"{share:.2f}"]


def girths(scale: float) -> Iterator[list[str]]:
    """Circumferences, which no body was asked for, of soldiers against ANSUR II's means."""
    yield ["sex", "circumference", "ANSUR II, mm", "bodies, mm", "off, %"]
    model, chart = BodyModel.load(), load_chart()
    trunk, leg = (chart.arm < 0.3) & (chart.neck < 0.5) & (chart.head < 0.5), (chart.leg > 0.5) & (chart.side >= 0)
    # Along the trunk: 0 hip joints, 1 C7; along the leg: 0 hip, 1 knee.
    places = [(trunk, chart.up, at) for at in (0.60, 0.27, -0.03)] + [(leg, chart.along_leg, at) for at in (0.25, 1.30)]
    for sex, means in GIRTHS_MM.items():
        generator, found = rng(), []
        for _ in range(int(60 * scale)):
            size = load_population("ansur").draw(rng=generator, sex=sex)
            person = model.person(Phenotype.of_size(size, rng=generator))
            skin, row = person.pose(np.zeros(len(DOFS)), np.eye(4)).skin.astype(np.float64), []
            for mask, along, at in places:
                height = float(np.median(skin[mask & (abs(along - at) < 0.05), 2]))
                faces = person.skin_faces[mask[person.skin_faces].all(axis=1)]
                ring = mesh_plane(Trimesh(skin, faces, process=False), [0, 0, 1], [0, 0, height]).reshape(-1, 3)
                row.append(1000 * float(ConvexHull(ring[:, :2]).area))
            found.append(row)
        for (name, mean), value in zip(means.items(), np.mean(found, axis=0), strict=True):
            yield [sex, name, f"{mean:.0f}", f"{value:.0f}", f"{100 * (value / mean - 1):.1f}"]


# Lengths between joints over stature, men and women: values and their sources.
LENGTHS: dict[str, tuple[tuple[str, str], tuple[tuple[float, float], str], ...]] = {
    "thigh": (("lpelvis", "lknee"), ((0.2425, 0.2425), "de Leva 1996, men's"), ((0.2348, 0.2348), "ANSUR II, trochanterion")),
    "shank": (("lknee", "lankle"), ((0.2384, 0.2475), "ANSUR II, epicondyle to malleolus"), ((0.2529, 0.2528), "de Leva 1996")),
    "upper arm": (("lshoulder", "lelbow"), ((0.1618, 0.1586), "de Leva 1996")),
    "forearm": (("lelbow", "lwrist"), ((0.1525, 0.1482), "ANSUR II, radiale to stylion"), ((0.1545, 0.1523), "de Leva 1996")),
    "hand": (("lwrist", "lhand"), ((0.0495, 0.0450), "de Leva 1996, third knuckle")),
    "shoulders apart": (("lshoulder", "rshoulder"), ((0.2083, 0.1975), "0.88 of ANSUR II's biacromial breadth")),
    "femur heads apart": (("lpelvis", "rpelvis"), ((0.0911, 0.0983), "160 mm, CT 2010, over ANSUR II's stature")),
}  # fmt: skip
# Heights over stature of children: trochanterion and tibiale (Snyder 1977), and what lies on top of them (de Leva 1996).
CHILD_HEIGHTS = {
    4: (0.463, 0.237),
    6: (0.491, 0.252),
    8: (0.501, 0.257),
    10: (0.518, 0.264),
    12: (0.519, 0.269),
    14: (0.517, 0.263),
}
ABOVE_TROCHANTERION, ABOVE_TIBIALE = 0.0032 / 1.741, 0.034 / 1.741


def standing(size: Anthropometry, generator: np.random.Generator) -> tuple[dict[str, Array], float]:
    """Joints by name of somebody who stands upright, over stature, above the ground; and the stature."""
    person = BodyModel.load().person(Phenotype.of_size(size, rng=generator))
    body = person.pose(np.zeros(len(DOFS)), np.eye(4))
    ground = np.array([0.0, 0.0, float(body.skin[:, 2].min())])
    return dict(zip(JOINTS, (body.joints - ground) / person.stature_m, strict=True)), person.stature_m


def joints(scale: float) -> Iterator[list[str]]:
    """Means and spreads of lengths between joints."""
    yield ["length", "sex", "published", "source", "ours", "SD", "deviation, %"]
    population = load_population("ansur")
    for sex, column in (("male", 0), ("female", 1)):
        generator = rng()
        people = [standing(population.draw(rng=generator, sex=sex), generator)[0] for _ in range(int(200 * scale))]
        for name, ((first, last), *sources) in LENGTHS.items():
            lengths = np.array([np.linalg.norm(at[first] - at[last]) for at in people])
            for values, source in sources:
                off = 100 * (lengths.mean() / values[column] - 1)
                figures = [f"{values[column]:.4f}", source, f"{lengths.mean():.4f}", f"{lengths.std():.4f}"]
                yield [name, sex, *figures, marked(off, LIMIT_OF_BODIES_PERCENT)]


def child_joints(scale: float) -> Iterator[list[str]]:
    """Heights of children's hips and knees."""
    yield ["years", "hip: published", "ours", "deviation, %", "knee: published", "ours", "deviation, %"]
    population, generator = load_population("cdc"), rng()
    for years, heights in CHILD_HEIGHTS.items():
        ages = (float(years), years + 1.0)
        people = [standing(population.draw(rng=generator, years=ages), generator)[0] for _ in range(int(60 * scale) or 1)]
        row = [str(years)]
        for joint, height, above in zip(("lpelvis", "lknee"), heights, (ABOVE_TROCHANTERION, ABOVE_TIBIALE), strict=True):
            ours, asked = np.mean([at[joint][2] for at in people]), height + above
            row += [f"{asked:.3f}", f"{ours:.3f}", marked(100 * (ours / asked - 1), LIMIT_OF_BODIES_PERCENT)]
        yield row


def hips(scale: float) -> Iterator[list[str]]:
    """Distance of the femur heads."""
    yield ["stature, m", "people", "femur heads apart, mm", "SD"]
    generator = rng()
    population = load_population("nhanes")
    sizes = [population.draw(rng=generator, years=(3.0, 81.0)) for _ in range(int(400 * scale))]
    found = np.array(
        [(h, 1e3 * h * np.linalg.norm(at["lpelvis"] - at["rpelvis"])) for at, h in (standing(s, generator) for s in sizes)]
    )
    for low in np.arange(0.9, 2.0, 0.1):
        chosen = found[(found[:, 0] >= low) & (found[:, 0] < low + 0.1), 1]
        if len(chosen):
            yield [f"{low:.1f} to {low + 0.1:.1f}", str(len(chosen)), f"{chosen.mean():.0f}", f"{chosen.std():.1f}"]


# The segment in whose frame a joint of Plug-in Gait is told, by our bones.
SEGMENT_OF = {
    "head": "head", "chest": "spine01", "hip": "pelvis", "shoulder": "spine01", "elbow": "{}upperarm", "wrist": "{}forearm",
    "hand": "{}hand", "pelvis": "pelvis", "knee": "{}thigh", "ankle": "{}shank", "foot": "{}foot",
}  # fmt: skip


def plug_in_gait(scale: float) -> Iterator[list[str]]:
    """Means and spreads of the offsets of Plug-in Gait's joint centres, both sides as the left one."""
    yield ["joint", "in the frame of", "forward, mm", "outward, mm", "up, mm", "distance, mm"]
    model, population, off = BodyModel.load(), load_population("ansur"), dict[str, list[Array]]()
    for sex in ("male", "female"):
        generator = rng()
        for _ in range(int(100 * scale) or 1):
            size = population.draw(rng=generator, sex=sex)
            wearer = Wearer(person := model.person(Phenotype.of_size(size, rng=generator)))
            body = seated(person)
            ours = dict(zip(JOINTS, body.joints, strict=True))
            for name, place in joint_centres(wearer.markers(body), wearer.size).items():
                sided = name not in SEGMENT_OF
                joint, side = (name[1:], name[0]) if sided else (name, "")
                bone = body.bones[BONE_INDEX[SEGMENT_OF[joint].format(side)]]
                mirror = (1.0, -1.0 if side == "r" else 1.0, 1.0)
                off.setdefault(joint, []).append(1e3 * (place - ours[name]) @ bone[:3, :3] * mirror)
    for joint, segment in SEGMENT_OF.items():
        each = np.array(off[joint])
        far = np.linalg.norm(each, axis=1)
        means = each.mean(axis=0).round() + 0.0
        columns = [f"{mean:.0f} ± {spread:.0f}" for mean, spread in zip(means, each.std(axis=0), strict=True)]
        if joint in ("head", "chest", "hip"):
            columns[1] = "0"  # of the middle of the body
        yield [joint, segment.format(""), *columns, f"{far.mean():.1f} ± {far.std():.1f}"]


def drivers(scale: float) -> Iterator[list[str]]:
    """How well drivers of all sizes find a pose."""
    yield ["body mass index", "drivers", "without a pose", "poses that hold", "seat ahead of its design position, mm"]
    people = {"subjects": [], "random": {"count": 2000, "population": "nhanes"}}
    scene = {"cars": ["sedan", "suv"], "occupancy": {}, "occupants": {"driver": {}}}
    config = SynthConfig.parse({"people": people, "scene": scene})
    scenes = CarScenes(config.scene, config, Plan(config, SEED))
    found: dict[int, list[tuple[int, bool, float]]] = {}
    for index in range(int(1000 * scale) or 1):
        generator, attempts = frame_rng(SEED, index), Attempts()
        cast = scenes.furnished_cast(index, attempts, rng=generator)
        if cast is None or (size := cast.people["driver"].phenotype.size) is None:
            continue
        posed = scenes.posing.pose(
            cast,
            partial(scenes.posing.goals, cast, index=index, rng=generator),
            lambda _slot, _pose, _body, seated: (None, seated),
            attempts,
        )
        low = max(edge for edge in BMI_EDGES if edge <= size.mass_kg / size.stature_m**2)
        found.setdefault(low, []).append((attempts.proposals, posed is not None, 1e3 * cast.settings["driver"].fore_aft_m))
    for low, high in zip(BMI_EDGES, (*BMI_EDGES[1:], None), strict=True):
        if low in found:
            draws, held, ahead = np.array(found[low]).T
            name = f"{low} and more" if high is None else f"{low} to {high}"
            yield [
                name,
                str(len(held)),
                f"{(1 - held).sum():.0f}",
                f"{100 * held.sum() / draws.sum():.0f} %",
                f"{ahead.mean():.0f}",
            ]


def face_measures(person: Person) -> list[float]:
    """Of the bare skin, mm: root of the nose to chin, breadth of the nose, breadth of the mouth, length of the left ear."""
    chart, skin = load_chart(), 1000.0 * person.rest_skin.astype(np.float64)
    x, y, z = 1000.0 * (chart.rest - (chart.heads["leye"] + chart.heads["reye"]) / 2).T
    face, middle = chart.head > 0.9, np.abs(y) < 0.1
    root, chin = face & middle & (x > 20) & (np.abs(z) < 12), face & middle & (x > 10) & (z < -80)
    wings = face & (np.abs(y) < 24) & (x > 16) & (z > -50) & (z < -34)
    lips = face & (np.abs(y) < 25) & (x > 20) & (z > -76) & (z < -70)
    ear = face & (y > 68) & (np.abs(x + 85) < 30) & (np.abs(z + 19) < 37)
    return [
        skin[root][np.argmin(skin[root, 0]), 2] - skin[chin, 2].min(),
        *(float(np.ptp(skin[part, axis])) for part, axis in ((wings, 1), (lips, 1), (ear, 2))),
    ]


def faces(scale: float) -> Iterator[list[str]]:
    """How faces of one head differ."""
    count = max(int(300 * scale), 2)
    at = np.array([face_measures(BodyModel.load().person(Phenotype(face=number))) for number in range(1, count + 1)])
    names = "chin to root of the nose", "breadth of the nose", "breadth of the mouth", "length of the ear"
    yield ["measure", "the data's own, mm", "mean, mm", "SD, mm"]
    for name, own, values in zip(names, face_measures(BodyModel.load().person(Phenotype())), at.T, strict=True):
        yield [name, f"{own:.1f}", f"{values.mean():.1f}", f"{values.std(ddof=1):.1f}"]


TABLES: dict[str, Callable[[float], Iterator[list[str]]]] = {
    "draws": draws,
    "bands": draws_by_band,
    "adults": lambda scale: bodies((18.0, 81.0), scale, ("nhanes", "ansur")),
    "children": lambda scale: bodies((3.0, 17.0), scale, ("nhanes", "cdc")),
    "infants": infants,
    "dummies": dummies,
    "girths": girths,
    "reach": reach,
    "joints": joints,
    "child joints": child_joints,
    "hips": hips,
    "plug-in gait": plug_in_gait,
    "drivers": drivers,
    "faces": faces,
}


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"of {', '.join(TABLES)}; all where none is named")
    parser.add_argument("--scale", type=float, default=1.0)
    args = parser.parse_args()
    for name in args.tables or TABLES:
        if name not in TABLES:
            parser.error(f"no table '{name}': {', '.join(TABLES)}")
        print(f"\n{name}\n")
        for number, row in enumerate(TABLES[name](args.scale)):
            print("| " + " | ".join(row) + " |", flush=True)
            if number == 0:
                print("|" + "---|" * len(row))


if __name__ == "__main__":
    main()
