"""`cabinpose info`: summarise a dataset or a recording, or list the takes of a subject."""

from __future__ import annotations

import dataclasses
import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cabinpose.app.cli.arguments import Maybe, SelectsFrames, ThingArgument, is_recording, refuse_selection
from cabinpose.app.cli.output import listed, print_json, print_rows, print_table, print_takes, print_unknown, progress, when
from cabinpose.app.extras import require
from cabinpose.core import ConfigError

if TYPE_CHECKING:
    from cabinpose.app.view.summary import DatasetSummary
    from cabinpose.store.recording import Survey


@dataclass(frozen=True, kw_only=True)
class Info(SelectsFrames):
    """Summarise a dataset (frames by car, person, action and view) or a recording (sources, rates, gaps, losses).

    With --subject: list the takes of a person in a folder of recordings. Of labels (.labels.jsonl): who set what and when; with
    --against, how far two who labelled the same frames agree.
    """

    dataset: ThingArgument
    """Folder of the dataset, a recording (.mcap), or labels that the studio wrote (.labels.jsonl)."""
    verify: bool = False
    """Read every frame of a dataset, which compares every checksum; those of a recording are always compared."""
    subject: Maybe[str] = None
    """List the takes of this subject code in the folder."""
    against: Maybe[Path] = None
    """Labels of somebody else for the same dataset."""


COMMAND = Info


def run(command: Info) -> None:
    """Print the summary; with `verify`, after every frame was read."""
    if command.dataset.suffix == ".jsonl":
        refuse_selection(command, "{} is of datasets, and these are labels")
        _print_labels(command.dataset, command.against, as_json=command.as_json)
    elif command.against is not None:
        raise ConfigError(f"{command.dataset} holds no labels, which --against compares", hint="give two .labels.jsonl files")
    elif command.subject is not None:
        if (command.dataset / "dataset.yaml").exists():
            raise ConfigError(
                f"{command.dataset} is a dataset, and --subject lists recordings",
                hint=f"count its frames with --select subject={command.subject}",
            )
        refuse_selection(command, "{} is of datasets, and --subject lists recordings")
        _print_takes_of(command.dataset, command.subject, as_json=command.as_json)
    elif is_recording(command.dataset):
        refuse_selection(command, "{} is of datasets, and this is a recording")
        _print_recording(command.dataset, as_json=command.as_json)
    else:
        _print_dataset(command)


def _print_dataset(command: Info) -> None:
    from cabinpose.app.cli.selection import selected
    from cabinpose.app.view.summary import summarise
    from cabinpose.store import missing_variables, open_dataset, read_manifest, warn_of_labels

    manifest = read_manifest(command.dataset)
    dataset = open_dataset(command.dataset, missing="ignore")
    chosen = selected(dataset, command)
    count = chosen.sizes["frame"]
    if command.verify:
        with progress(count, "frames") as report:
            for i in range(count):
                chosen.isel(frame=i).load()
                report(i + 1)
    warn_of_labels(chosen, str(command.dataset))
    summary = summarise(dataset, manifest, command.dataset, chosen)
    lacks = missing_variables(manifest)
    unchecked, unbound = dataset.attrs["parts_without_checksum"], dataset.attrs["parts_without_dataset"]
    if command.as_json:
        checks = {"verified": command.verify, "checksum": manifest.checksum, "parts_without_checksum": unchecked}
        checks |= {"parts_without_dataset": unbound, "schema_version": manifest.schema_version, "missing_variables": lacks}
        print_json(dataclasses.asdict(summary) | checks | ({"selection": manifest.selection} if manifest.selection else {}))
        return
    rows = _dataset_rows(summary)
    if told := manifest.selection:
        by = f", by {told['by']}" if "by" in told else ""
        rows.insert(2, ("chosen of", f"{told['name']} ({told['of']}){by}"))
    print_rows(rows)
    if lacks:
        print(f"it is of version {manifest.schema_version} of the standard and lacks {', '.join(lacks)}")
        print(f"what can be known of them is added by: cabinpose upgrade {command.dataset}")
    if unbound:
        those = f"{unbound} of {summary.parts} parts"
        print(f"{those} were written before parts named their dataset: whether they are of this one is not known")
    if command.verify:
        print(f"{count} frames were read; all checksums are right")
        if unchecked or manifest.checksum is None:
            where = ["dataset.yaml"] * (manifest.checksum is None) + [f"{unchecked} of {summary.parts} parts"] * bool(unchecked)
            print(f"{' and '.join(where)} were written without a checksum of names and settings, which are therefore unchecked")


def _print_labels(path: Path, against: Path | None, *, as_json: bool) -> None:
    """Who labelled what and when; and how far somebody else agrees."""
    from cabinpose.app.label.agreement import agreement_of, work_of
    from cabinpose.store import read_history

    header, history = read_history(path)
    works, agreement = work_of(history), None if against is None else agreement_of(path, against)
    if as_json:
        roles = [dataclasses.asdict(work) for work in works]
        compared = {} if agreement is None else {"agreement": dataclasses.asdict(agreement)}
        print_json({"labels": str(path), "dataset": header["dataset"], "roles": roles} | compared)
        return
    rows = [("labels", str(path)), ("of dataset", str(header["dataset"]))]
    for work in works:
        span = f"{work.first[:16]} to {work.last[:16]} UTC; {listed(work.how)}"
        rows.append((work.role, f"{work.joints} joints of {work.frames} people in frames, {span}"))
    if agreement is not None:
        one, other = agreement.alone
        rows.append(("labelled by both", f"{agreement.joints} joints of {agreement.frames}; alone {one} here, {other} there"))
        if agreement.median_px is not None:
            within = ", ".join(f"{100 * share:.0f} % within {limit:g} px" for limit, share in agreement.within.items())
            rows.append(("apart", f"median {agreement.median_px:.1f} px, 90 % within {agreement.p90_px:.1f} px; {within}"))
        beyond = "" if agreement.kappa is None else f", beyond chance (Cohen's kappa) {agreement.kappa:.2f}"
        rows.append(("seen alike", f"{100 * agreement.same_state:.0f} % of the joints{beyond}"))
    print_rows(rows)


def _dataset_rows(s: DatasetSummary) -> list[tuple[str, str]]:
    whole = "" if s.parts == s.planned_parts else f" of {s.planned_frames} planned: go on with --resume"
    chosen = "" if s.selected == s.frames else f"; {s.selected} selected, counted below"
    valid = "no depth" if math.isnan(s.valid_pixels) else f"{100 * s.valid_pixels:.1f} % of the pixels valid"
    people = (f"{n} in {count} {'frame' if count == 1 else 'frames'}" for n, count in s.by_people.items())
    joints = max(sum(s.visibility.values()), 1)
    rows = [
        ("dataset", s.folder),
        ("made by", f"{s.generator}, seed {s.seed}, licence {s.licence}"),
        ("frames", f"{s.frames} in {s.parts} of {s.planned_parts} parts{whole}{chosen}"),
        ("size", f"{s.bytes_on_disk / 1e6:.1f} MB, {s.bytes_on_disk / max(s.frames, 1) / 1e3:.0f} kB a frame"),
        ("image", f"{s.width}x{s.height}, {valid}"),
        ("variables", ", ".join(s.variables)),
        ("depth", _depths(s.depth_histogram)),
        ("cars", listed(s.by_car, most=12)),
        ("views", listed(s.by_pov)),
        ("people a frame", ", ".join(people)),
        ("seats", listed({seat: count for seat, count in s.by_seat.items() if count})),
        ("subjects", listed(s.by_subject, most=12)),
        ("actions", listed(s.by_action, most=12)),
        ("joints", ", ".join(f"{name.replace('_', ' ')} {100 * n / joints:.1f} %" for name, n in s.visibility.items())),
    ]
    if s.proposals:  # of generated datasets alone
        rejected = f"rejected: {listed(s.rejections) or 'none'}"
        if s.acceptance is None:
            rows.append(("proposed", f"{s.proposals} poses and activities; {rejected}"))
        else:
            rows.append(("acceptance", f"{100 * s.acceptance:.1f} % of {s.proposals} poses; {rejected}"))
    return rows


def _depths(histogram: tuple[float, ...]) -> str:
    """The 5, 50 and 95 % quantiles of the depths, to the width of a bin."""
    if not histogram:
        return "no valid pixel"
    import numpy as np

    from cabinpose.app.view.summary import BIN_M

    low, middle, high = np.searchsorted(np.cumsum(histogram), (0.05, 0.5, 0.95)) * BIN_M
    return f"median {middle:.2f} m, 90 % within {low:.2f} m to {high + BIN_M:.2f} m"


def _print_takes_of(folder: Path, subject: str, *, as_json: bool) -> None:
    """List the takes of a subject in a folder."""
    require("record")
    from cabinpose.store.recording import takes_in

    files = takes_in(folder)
    shown = [file for file in files if file.shows(subject)]
    unknown = [file for file in files if file.take is None]
    if as_json:
        takes = [
            {"file": str(f.path), "started_ns": f.started_ns, "bytes": f.bytes, **f.take.model_dump(mode="json")}
            for f in shown
            if f.take is not None
        ]
        print_json({"subject": subject, "takes": takes, "unknown": [str(f.path) for f in unknown]})
        return
    if shown:
        print_takes(shown)
    else:
        print(f"no take of {subject} in {folder}")
    print_unknown(unknown)


def _print_recording(path: Path, *, as_json: bool) -> None:
    require("record")
    from cabinpose.app.report.recordings import BODY_WORDS, body_rows, source_rows, topic_rows
    from cabinpose.record.sources.tof import described
    from cabinpose.store.recording import survey

    found = survey(path)
    for body in found.bodies:
        for doubt in body.doubts:
            warnings.warn(f"{path}: {body.subject or body.source}: {doubt.words} ({doubt.hint})", stacklevel=2)
    judged = {body.source for body in found.bodies if body.doubts}
    for source in found.sources:
        for words in source.doubts if source.name not in judged else ():
            warnings.warn(f"{path}: {source.name}: {words}, as was said while it was recorded", stacklevel=2)
    if as_json:
        print_json(_as_data(found))
        return
    take, damage = found.take, found.damage
    who = (f"{s.code}{f' ({s.seat})' if s.seat else ''}{f', consent {s.consent}' if s.consent else ''}" for s in take.subjects)
    wheel = take.drive_side and f"wheel on the {take.drive_side}"
    state = "whole" if damage.whole else "without its end: `cabinpose recover` gives it one"
    state = "; ".join([state, *([", ".join(damage.counted())] if damage.counted() else [])])
    print_rows(
        [
            ("recording", str(path)),
            ("recorded", f"{when(found.started_ns)}, {found.seconds:.1f} s"),
            ("size", f"{found.bytes / 1e6:.1f} MB, {found.bytes / 1e6 / max(found.seconds, 1e-9):.1f} MB/s"),
            ("take", ", ".join(filter(None, (take.action, take.car, wheel))) or "nothing is said of it"),
            ("subjects", ", ".join(who) or "none named"),
            ("file", state),
        ]
    )
    print()
    print_table(source_rows(found))
    if found.bodies:
        print()
        print_table(body_rows(found.bodies), words=BODY_WORDS)
    if setups := [(f"{s.name} set-up", ", ".join(described(values))) for s in found.sources for values in s.setups]:
        print()
        print_rows(setups)
    errors = [(s.name, s.status.error) for s in found.sources if s.status is not None and s.status.error]
    if errors:
        print()
        print_rows(errors)
    print()
    print_table(topic_rows(found), words=(0, 1))


def _as_data(found: Survey) -> dict[str, Any]:
    """A survey as plain data, without the arrival time of each sample."""
    from cabinpose.app.report.recordings import bodies_as_data

    plain = dataclasses.asdict(found)
    for source in plain["sources"]:
        del source["arrival_ns"]
        source["gaps_s"] = source.pop("gaps").tolist()
    return {
        "recording": str(found.path),
        "take": found.take.model_dump(mode="json"),
        **{key: plain[key] for key in ("bytes", "started_ns", "seconds", "damage", "topics")},
        "bodies": bodies_as_data(found.bodies),
        "sources": {source.pop("name"): source for source in plain["sources"]},
    }
