"""The numbers of pages are those of files: tables and sentences of `docs/figures`, the models' cards, the baseline's JSON."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cabinpose.estimate import packaged_detectors, packaged_models

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TABLES = {
    data["page"]: data["tables"]
    for path in (DOCS / "figures").glob("*.json")
    if "tables" in (data := json.loads(path.read_text("utf-8")))
}
SENTENCES = json.loads((DOCS / "figures" / "sentences.json").read_text("utf-8"))["sentences"]
SOURCE = {"command", "seed", "date", "machine"}
MEASURED = re.compile(r"\d\.\d|\d %")
WORDS = {5: "five", 7: "seven"}


def words(text: str) -> str:
    """A text without its breaks of lines."""
    return " ".join(text.split())


def page(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def tables(text: str) -> list[tuple[str, list[list[str]]]]:
    """The tables of a page that hold measured numbers: the heading above each, and its rows of cells."""
    found, heading, rows = [], "", list[list[str]]()
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip()[1:-1].split("|")])
            continue
        if len(rows) > 1:
            found.append((heading, [rows[0], *rows[2:]]))
        rows = []
        if line.startswith("#"):
            heading = line.strip("# ")
    return [(heading, rows) for heading, rows in found if any(MEASURED.search(cell) for row in rows[1:] for cell in row)]


def card(model: str) -> str:
    return words((DOCS / "models" / f"{model}-card.yaml").read_text("utf-8"))


# What a page says beside the card that says it too: each number in brackets stands in the card.
OF_CARDS = [
    ("in_car", r"\| plain \| (\d+) \|" + r" [\d.]+ → ([\d.]+) \|" * 7),
    ("in_car", r"\| children \(passenger\) \| (\d+) \|" + r" [\d.]+ → ([\d.]+) \|" * 6),
    ("in_car", r"\| child seats and luggage \| (\d+) \|" + r" – \|" * 6 + r" [\d.]+ → ([\d.]+) \|"),
    ("five_seats", r"\| all five places \| (\d+) \|" + r" [\d.]+ → ([\d.]+) \|" * 6),
    ("five_seats", r"\| infants and children in their seats, rear row \| (\d+) \|" + r" [\d.]+ → ([\d.]+) \|" * 5),
    ("room", r"ones alone: \*\*([\d.]+) %\*\* of all joints within 10 cm \(95 % interval ([\d.]+) to ([\d.]+)\)"),
    ("room", r"mean pose placed at the true torso has ([\d.]+) % and ([\d.]+) cm\. A2J, \D+ has ([\d.]+) %"),
    ("room", r"without it, ([\d.]+) % are within 10 cm"),
    ("room_top", r"it never saw: ([\d.]+) % of the joints in the image within 10 cm, median ([\d.]+) cm; hands (\d+) %"),
    ("room_top", r"frames from above \*\*([\d.]+) %\*\* \(([\d.]+) to ([\d.]+)\)"),
    ("lift", r"true 2D joints to ([\d.]+) % within 10 cm \(PCKh@0\.5 with a head of 20 cm; AUC ([\d.]+),"),
    ("lift", r"it gets ([\d.]+) % and ([\d.]+), where `in_car` itself, which sees depth, has ([\d.]+) and ([\d.]+)"),
    ("parts", r"a mean IoU of ([\d.]+) % over the eight parts \(head ([\d.]+),"),
    ("paf", r"\| plain \| (\d+) \|" + r" ([\d.]+) → ([\d.]+) \|" * 6 + r"\n?\s?\| drivers"),
    ("paf", r"\| right-hand drive \| (\d+) \|" + r" [\d.]+ → ([\d.]+) \|" * 6),
]  # fmt: skip


@pytest.mark.parametrize("name", sorted(TABLES))
def test_tables_are_those_of_their_file(name: str) -> None:
    """A table with measured numbers has its file, which says where they come from; other tables state what was chosen."""
    kept = [(each["section"], each["rows"]) for each in TABLES[name]]
    chosen = {"key", "take", "variable", "`pose_truth`", "model", "name"} if name != "docs/benchmarks.md" else set()
    on_page = [(heading, rows) for heading, rows in tables(page(name)) if rows[0][0] not in chosen]
    on_page = [each for each in on_page if each[1][0][:2] != ["", "`in_car`"] and each[1][0][1:3] != ["head", "neck"]]
    assert [rows[0] for _, rows in kept] == [rows[0] for _, rows in on_page], (
        "a table of measured numbers has its file in docs/figures"
    )
    where = "change a number in docs/figures, with its command, seed, date and machine, and on the page"
    assert kept == on_page, where
    for each in TABLES[name]:
        assert set(each) == SOURCE | {"section", "rows"}
        assert each["command"]
        assert re.search(r"\d{4}-\d\d-\d\d$", each["date"])


@pytest.mark.parametrize("source", SENTENCES, ids=lambda source: source["page"])
def test_sentences_say_the_measured_values(source: dict[str, Any]) -> None:
    assert set(source) > SOURCE
    text = words(page(source["page"]))
    assert [said for template in source["says"] if (said := template.format(**source["values"])) not in text] == []


@pytest.mark.parametrize(("model", "pattern"), OF_CARDS)
def test_the_page_of_models_agrees_with_the_cards(model: str, pattern: str) -> None:
    said = re.search(pattern, words(page("docs/models/index.md")))
    assert said is not None, pattern
    assert [
        number for number in said.groups() if not re.search(rf"(?<![\d.]){re.escape(number)}(?![\d]|\.\d)", card(model))
    ] == []


def test_the_models_are_as_many_and_as_large_as_pages_say() -> None:
    every, finding = WORDS[len(packaged_models())], WORDS[len(packaged_detectors())]
    megabytes = sum(path.stat().st_size for path in packaged_models().values()) / 1e6
    assert f"{every.capitalize()} [trained models](docs/models/index.md) come with the package" in page("README.md")
    assert f"{every.capitalize()} models come with the package, {finding} of them find people" in page("docs/five-minutes.md")
    assert f"{every.capitalize()} models come with the package, {megabytes:.0f} MB together" in page("docs/models/index.md")


def test_pages_agree_with_the_table_of_benchmarks() -> None:
    cells = {row[0]: row for table in TABLES["docs/benchmarks.md"] for row in table["rows"]}
    installed = cells["base install: site-packages with the package; time"][2]
    size = re.search(r"takes (\d+) MB with all it needs", page("README.md"))
    assert size is not None
    assert abs(float(size[1]) / float(installed.split(" MB")[0]) - 1) < 0.01
    kept = cells["acceptance: accepted of all poses drawn, one occupant; five"]
    before, after = (
        re.findall(r"0\.\d\d(?! to|\))", cell.replace("(0.94 to 0.95)", "").replace("(0.78 to 0.81)", "")) for cell in kept[2:]
    )
    decision = words(page("docs/decisions/0008-whole-body-solver.md"))
    assert f"of one person rises from {before[0]} to {after[0]}, of full cars from {before[1]} to {after[1]}" in decision


def test_the_baselines_page_is_its_json() -> None:
    text = words(page("docs/baseline/README.md"))
    one, five = (
        json.loads((DOCS / "baseline" / f"{name}.json").read_text("utf-8")) for name in ("pose-spread", "pose-spread-five")
    )
    assert f"{one['scenes']['all']['count']} scenes of" in text
    assert (
        f"| people kept / poses proposed | {one['scenes']['all']['kept']:.2f} | {five['scenes']['all']['kept']:.2f} (five people"
        in text
    )
    rejected = one["rejections"]
    assert "car {car}, self {self}, camera {camera}, person {person}, reach {reach} |".format(**rejected) in text
    for spread, cars in ((one, "14, 14, 14, 15, 13; 15, 14"), (five, "3, 9, 15, 18, 16; 20, 19")):
        names = ("hatchback", "sedan", "suv", "van", "shuttle", "city_car", "coupe")
        shares = [100 * spread["cars"].get(name, 0) / sum(spread["cars"].values()) for name in names]
        assert cars in text
        assert [float(n) for n in re.findall(r"\d+", cars)] == pytest.approx(shares, abs=0.51)


def test_errors_of_the_budget_add_up_as_the_page_says() -> None:
    """The root of the sum of squares of each error alone, from the table."""
    budget = next(each["rows"][1:] for each in TABLES["docs/alignment.md"] if each["section"] == "The error budget")
    alone = [float(row[6]) for row in budget if row[0] not in ("`none`", "`all`")]
    (together,) = (float(row[6]) for row in budget if row[0] == "`all`")
    text = words(page("docs/alignment.md"))
    said = re.search(r"of each alone is ([\d.]+) cm, all together ([\d.]+) cm", text)
    assert said is not None
    assert float(said[1]) == pytest.approx(sum(value**2 for value in alone) ** 0.5, abs=0.01)
    assert float(said[2]) == together


@pytest.mark.real_data
def test_the_table_beside_real_frames_is_what_its_command_prints(
    real_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = real_data("itop/itop_front_64.npz")
    spec = importlib.util.spec_from_file_location("compare_itop", ROOT / "tools" / "compare_itop.py")
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    monkeypatch.setattr("sys.argv", ["compare_itop.py", str(frames), "--picture", str(tmp_path / "itop.png")])
    spec.loader.exec_module(tool)
    tool.main()
    ((_, printed),) = tables(capsys.readouterr().out)
    assert printed == TABLES["docs/itop-comparison.md"][0]["rows"]


def test_the_checks_find_what_is_wrong() -> None:
    text = "# A\n\n| a | b |\n|---|---|\n| 1 | 2.5 cm |\n\n## B\n| c |\n|---|\n| no number |\n"
    assert tables(text) == [("A", [["a", "b"], ["1", "2.5 cm"]])]
    assert tables(text.replace("2.5", "2.6")) != tables(text)
    assert not re.search(r"(?<![\d.])96\.6(?![\d]|\.\d)", "96.65 and 196.6")
