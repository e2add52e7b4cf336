"""What is wrong with the words of a command, in the style of all other errors, in place of tyro's boxes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tyro.conf import Positional
from tyro.constructors import MISSING, MISSING_NONPROP, StructFieldSpec

from cabinpose.core import ELSEWHERE, CabinposeError, alike, by_word, keys_alike

# What others call our commands; of two words, such as `config init`, the first is the command.
COMMANDS = by_word(
    {
        "synth": "generate gen create make render simulate sample scenes dataset new",
        "config init": "init template",
        "config check": "check lint verify validate test",
        "config schema": "schema keys options",
        "car init, car check": "cars mesh vehicle import_car",
        "models, info": "list ls",
        "info": "stats summary describe inspect count head status",
        "view": "show display visualize visualise plot draw gallery preview",
        "export": "convert to_coco to_yolo dump save",
        "import": "load ingest bag rosbag read convert",
        "train": "fit learn finetune fine_tune",
        "models": "model zoo download weights pretrained",
        "predict": "detect infer inference track estimate pose run",
        "evaluate": "eval val validate test score metrics benchmark_model accuracy compare",
        "live": "stream camera webcam demo",
        "serve": "server deploy rest grpc triton",
        "record": "capture acquire rec",
        "forget": "delete remove rm erase",
        "emulate": "emulator mock",
        "calibrate": "calib calibration extrinsics",
        "align": "sync synchronise synchronize register",
        "studio": "gui ui web app browser editor label annotate",
        "bench": "benchmark speed profile timing",
        "--version": "version about",
    }
)
# What others call our flags; what follows the verb without one is `_OBJECTS`.
FLAGS = by_word(
    {
        "--out": "o output output_dir out_dir outdir output_path save save_dir save_path project dest destination to",
        "--frames": "n num num_frames n_frames count num_samples num_images samples number limit max_frames",
        "--overwrite": "f force exist_ok yes y replace clobber",
        "--workers": "j jobs n_jobs num_workers threads n_workers nproc processes",
        "--config": "c cfg conf_file configuration recipe settings yaml file scene rig",
        "--model": "m weights checkpoint ckpt network net detector onnx method models",
        "--predictions": "p preds pred results found answers detections dt",
        "--presence": "conf conf_thres confidence threshold score_threshold min_score thr",
        "--devices": "device gpu gpus cuda",
        "--init": "pretrained checkpoint ckpt weights resume_from load",
        "--resume": "continue restart",
        "--splits": "split_file folds partition",
        "--validate": "val val_split validation",
        "--seed": "s random_seed rng",
        "--json": "as_json j print_json machine format_json",
        "--duration, --seconds": "time length t duration_s seconds timeout",
        "--host": "address bind ip listen",
        "--port": "p server_port",
        "--method": "arch architecture backbone algorithm m model network",
        "--subject": "person participant name who",
        "--select": "filter where only query subset",
        "--labels": "annotations gt ground_truth corrected",
        "--scheduler": "dask cluster",
        "--all": "verbose v full everything",
        "--unit": "units scale",
        "--sensor": "camera camera_model",
    }
)
_OBJECTS = (
    "data", "dataset", "datasets", "input", "inputs", "i", "source", "src", "path", "folder", "images", "file", "recording",
    "bag", "mesh", "model",
)  # fmt: skip
_SETTINGS = MappingProxyType(  # of verbs whose settings are no flags: their model, and how a key of it is given
    {
        "synth": ("cabinpose.synth", "SynthConfig", "write KEY=VALUE without dashes: {}"),
        "train": ("cabinpose.estimate", "TrainConfig", "write it in the file of --config: {}"),
    }
)
_ENDINGS = MappingProxyType(  # of a word that is one too many, the flag that takes such files
    {
        ".jsonl": "--predictions", ".parquet": "--predictions", ".zarr": "--predictions", ".onnx": "--model", ".npz": "--model",
        ".yaml": "--config", ".yml": "--config",
    }
)  # fmt: skip
_POSITIONAL = get_args(Positional[int])[1]
_NUMBER = re.compile(r"-[\d.]")


@dataclass(frozen=True)
class Flag:
    """What a command takes: name: with its dashes, or the metavar of what follows the verb · kind: the type without None."""

    name: str
    kind: Any
    about: str
    required: bool
    positional: bool

    @classmethod
    def of(cls, field: StructFieldSpec) -> Flag | None:
        """Of a field of a command; None for one whose values have fields of their own."""
        kind, *marks = get_args(field.type) if get_origin(field.type) is Annotated else (field.type,)
        told = [mark for mark in marks if hasattr(mark, "metavar") and hasattr(mark, "name")]
        named = next((mark.name for mark in told if mark.name), field.name).replace("_", "-")
        metavar = next((mark.metavar for mark in told if mark.metavar), named.upper())
        if get_origin(kind) in (Union, UnionType):
            inner = tuple(each for each in get_args(kind) if each is not NoneType)
            kind = inner[0] if len(inner) == 1 else Union[inner]  # noqa: UP007 - made of what it is
        inner = get_args(kind)[0] if get_origin(kind) is tuple else kind
        if any(hasattr(inner, fields) for fields in ("__dataclass_fields__", "model_fields", "_fields")):
            return None
        about = (field.helptext() if callable(field.helptext) else field.helptext) or ""
        required = field.default in (MISSING, MISSING_NONPROP) if not isinstance(field.default, (tuple, list)) else False
        placed = _POSITIONAL in marks
        named = f"no-{named}" if field.default is True else named
        return cls(metavar if placed else f"--{named}", kind, " ".join(about.split()).removesuffix("."), required, placed)

    @property
    def several(self) -> bool:
        """Whether it takes any number of words."""
        return get_origin(self.kind) is tuple

    @property
    def takes(self) -> str:
        """What a value of it is, as messages say it."""
        kind = get_args(self.kind)[0] if self.several else self.kind
        if get_origin(kind) is Literal:
            return f"one of {', '.join(map(str, get_args(kind)))}"
        return {int: "a whole number", float: "a number", Path: "a path"}.get(kind, "a value")

    def wrong(self, word: str) -> bool:
        """Whether a word is no value of it."""
        kind = get_args(self.kind)[0] if self.several else self.kind
        if get_origin(kind) is Literal:
            return word not in map(str, get_args(kind))
        try:
            return kind in (int, float) and kind(word) is None
        except ValueError:
            return True


def unknown_command(verb: str, verbs: Sequence[str]) -> CabinposeError:
    """The error for a command that does not exist."""
    near = tuple(name for name in COMMANDS.get(verb.lower().replace("-", "_"), ()) if name.split()[0] in (*verbs, "--version"))
    near = near or alike(verb, verbs, {})
    meant = f"did you mean {' or '.join(f'`cabinpose {name}`' for name in near)}? " if near else ""
    return CabinposeError(f"there is no command '{verb}'", hint=f"{meant}`cabinpose --help` lists them")


def unknown_inner(prog: str, inner: Sequence[str], word: str) -> CabinposeError:
    """The error for a word that should name one of a command's own commands; empty where there is none."""
    known = f"known: {', '.join(inner)}"
    if not word or word.startswith("-") or "." in word:
        return CabinposeError(f"`{prog}` needs a word more{f' before {word}' if word else ''}", hint=known)
    verb = prog.partition(" ")[2]
    near = [name.removeprefix(f"{verb} ") for name in COMMANDS.get(word.lower(), ()) if name.startswith(f"{verb} ")]
    near = near or list(alike(word, inner, {}))
    meant = f"did you mean {' or '.join(near)}? " if near else ""
    return CabinposeError(f"there is no `{prog} {word}`", hint=f"{meant}{known}")


def misplaced(prog: str, kind: str, names: Sequence[str], words: Sequence[str]) -> str:
    """A hint for the first of some words where another one should stand; empty where there is none to give."""
    if found := next((word for word in words[1:] if word in names), None):
        rest = " ".join(word for word in words if word != found)
        return f"the {kind} comes first: {prog} {found} {rest}"
    return f"the {kind} comes before {words[0]}: {prog} {kind.upper()} {words[0]}; " if Path(words[0]).exists() else ""


def complaint(
    prog: str, fields: Sequence[StructFieldSpec], words: Sequence[str], having: Callable[[str], Sequence[str]] = lambda _: ()
) -> CabinposeError | None:
    """The first thing that is wrong with the words of a command; None where nothing is seen.

    Parameters
    ----------
    prog
        The command, "cabinpose synth".
    fields
        What it takes.
    words
        What was given.
    having
        The names of the verb's other commands that have a flag.
    """
    taken = [flag for field in fields if (flag := Flag.of(field)) is not None]
    flags = {flag.name: flag for flag in taken if not flag.positional}
    objects = [flag for flag in taken if flag.positional]
    given: dict[str, list[str]] = {}
    loose: list[str] = []
    last: Flag | None = None
    for number, word in enumerate(words):
        if not word.startswith("-") or word == "-" or _NUMBER.match(word):
            if last is not None and (last.several or not given[last.name]) and last.kind is not bool:
                given[last.name].append(word)
            else:
                loose.append(word)
            continue
        name, equals, value = word.partition("=")
        last = flags.get(name.replace("_", "-"))
        if last is None:
            follows = value if equals else next((each for each in words[number + 1 : number + 2] if each[:1] != "-"), "")
            return CabinposeError(f"there is no flag {name}", hint=_hint_of_flag(prog, name, follows, taken, having))
        given[last.name] = [value] if equals else []
    for name, values in given.items():
        if error := _wrong_value(flags[name], values):
            return error
    return _wrong_objects(prog, objects, flags, given, loose)


def _wrong_value(flag: Flag, values: Sequence[str]) -> CabinposeError | None:
    if flag.kind is bool:
        return CabinposeError(f"{flag.name} takes no value", hint=f"leave out '{values[0]}'") if values else None
    hint = f"{flag.name}: {flag.about}" if flag.about else None
    if not values and not flag.several:
        return CabinposeError(f"{flag.name} needs {flag.takes}", hint=hint)
    bad = next((word for word in values if flag.wrong(word)), None)
    if bad is None:
        return None
    kind = get_args(flag.kind)[0] if flag.several else flag.kind
    near = alike(bad, map(str, get_args(kind)), {}) if get_origin(kind) is Literal else ()
    return CabinposeError(f"{flag.name} must be {flag.takes}, not '{bad}'", hint=f"did you mean {near[0]}?" if near else hint)


def _wrong_objects(
    prog: str, objects: Sequence[Flag], flags: Mapping[str, Flag], given: Mapping[str, list[str]], loose: Sequence[str]
) -> CabinposeError | None:
    """What is wrong with the words that belong to no flag, and what is missing."""
    absent = [flag for flag in flags.values() if flag.required and flag.name not in given]
    rest = list(loose)
    for flag in objects:
        if flag.several:
            rest, taken = [], rest
        else:
            taken, rest = rest[:1], rest[1:]
        if bad := next((word for word in taken if flag.wrong(word)), None):
            near = alike(bad, map(str, get_args(flag.kind)), {})
            hint = f"did you mean {near[0]}?" if near else f"`{prog} --help` says what it takes"
            return CabinposeError(f"{flag.name} must be {flag.takes}, not '{bad}'", hint=hint)
        if flag.required and not taken:
            absent.insert(0, flag)
    if rest:
        name = _ENDINGS.get(Path(rest[0]).suffix) or (absent[0].name if len(absent) == 1 and not absent[0].positional else "")
        if not (name or absent or Path(rest[0]).suffix or "--out" in given):  # a folder, by its looks
            name = "--out"
        if "=" in rest[0] and name not in flags:
            meant = "KEY=VALUE belongs to `cabinpose synth` and `cabinpose config check`; "
        else:
            meant = f"did you mean {name} {rest[0]}? " if name in flags else ""
        return CabinposeError(f"'{rest[0]}' is one word too many", hint=f"{meant}`{prog} --help` says what it takes")
    if not absent:
        return None
    named = [flag.name if flag.positional else f"{flag.name} {_metavar(flag)}" for flag in absent]
    told = "; ".join(f"{flag.name}: {flag.about}" for flag in absent if flag.about)
    return CabinposeError(f"`{prog}` needs {' and '.join(named)}", hint=told or f"`{prog} --help` says what it takes")


def _metavar(flag: Flag) -> str:
    kind = get_args(flag.kind)[0] if flag.several else flag.kind
    return {int: "N", float: "NUMBER", Path: "PATH"}.get(kind, flag.name.strip("-").upper())


def _hint_of_flag(prog: str, name: str, value: str, taken: Sequence[Flag], having: Callable[[str], Sequence[str]]) -> str:
    """What a flag that does not exist may be."""
    word = name.lstrip("-").replace("-", "_").lower()
    lists = f"`{prog} --help` lists the flags"
    if elsewhere := having(name):
        return f"{name} is of {', '.join(elsewhere)}"
    near = [flag.name for flag in taken if not flag.positional and flag.name in FLAGS.get(word, ())]
    first = next((flag for flag in taken if flag.positional), None)
    if not near and first is not None and word in _OBJECTS and get_origin(first.kind) is not Literal:
        metavar = re.findall(r"[A-Z]{2,}", first.name)[:1] or [first.name]
        return f"the {metavar[0].lower()} follows the verb: {prog} {metavar[0]}"
    near = near or [f"--{each}" for each in alike(word, [flag.name[2:] for flag in taken if not flag.positional], {})]
    if near:
        return f"did you mean {' or '.join(near)}? {lists}"
    if keys := _keys_like(prog.split()[1], word, value):
        return keys
    return f"{ELSEWHERE[word]}; {lists}" if word in ELSEWHERE else lists


def _keys_like(verb: str, word: str, value: str) -> str:
    """The keys of the settings of a verb that are called like a flag; empty where there are none."""
    if verb not in _SETTINGS:
        return ""
    module, name, how = _SETTINGS[verb]
    near = keys_alike(getattr(import_module(module), name), word.rpartition(".")[2], value)
    told = " or ".join(near)
    return how.format(told if verb == "synth" else told.replace("=", ": ")) if near else ""
