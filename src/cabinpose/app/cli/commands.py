"""What can be typed: one dataclass a command, whose fields are its flags and whose docstrings are its help.

Only the standard library and tyro are imported here, so that `--help` is quick; the work is in the module that
`RUNNERS` names for a command, imported when the command runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Optional, get_args

from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes, Positional, arg, subcommand

from cabinpose.app.cli.align_commands import Align, Calibrate, Lab
from cabinpose.app.cli.arguments import (
    DatasetArgument,
    JsonFlag,
    Maybe,
    SelectFlag,
    SplitFlag,
    SplitsFlag,
    ThingArgument,
    several,
)
from cabinpose.app.cli.car_commands import Car
from cabinpose.app.cli.exchange_commands import Export, Import
from cabinpose.app.cli.mocap_commands import EvaluateMocap
from cabinpose.app.cli.record_commands import Forget, Record, Recover
from cabinpose.app.cli.serve import Serve


@dataclass(frozen=True)
class Synth:
    """Generate a dataset: people in cars, or one person in a room, seen by a Time-of-Flight camera.

    Same configuration, seed and frame: same bytes, whatever the number of workers.
    """

    out: Path
    """Folder of the dataset."""
    frames: Maybe[int] = None
    """Number of frames to generate; default: all combinations, where the configuration has a number of them."""
    overrides: Annotated[Positional[tuple[str, ...]], several("[KEY=VALUE ...]")] = ()
    """What differs from the configuration, such as scene.cars=[suv] or camera.sensor=evk75123."""
    config: Maybe[Path] = None
    """Configuration (YAML), which `cabinpose config init` writes; default: people in all seven cars."""
    workers: Maybe[int] = None
    """Threads; default: one per core."""
    scheduler: Maybe[str] = None
    """Address of a running Dask scheduler, whose workers make the parts; exclusive with --workers."""
    seed: int = 0
    """Seed of all randomness."""
    resume: bool = False
    """Go on where a run of the same configuration stopped."""
    overwrite: bool = False
    """Replace the dataset that is in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class ConfigInit:
    """Write a configuration to start from, every key with its default."""

    file: Annotated[Positional[Optional[Path]], several("FILE")] = None
    """File to write; stdout if left out."""
    scene: Literal["cabin", "room"] = "cabin"
    """People in cars, or one person standing in a room in ITOP's geometry."""


@dataclass(frozen=True)
class ConfigCheck:
    """Check a configuration as `synth` would, meshes, recordings and a few scenes included, and say what it asks for."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Configuration (YAML)."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class ConfigFrame:
    """Write the scene of a generated dataset's frame as a configuration: who sits how, seen from where, to the last bit."""

    dataset: DatasetArgument
    frame: Annotated[Positional[int], arg(metavar="FRAME")]
    """Number of the frame."""
    file: Annotated[Positional[Optional[Path]], several("FILE")] = None
    """File to write; stdout if left out."""


@dataclass(frozen=True)
class ConfigSchema:
    """Print the JSON Schema of the configuration, for editors and validators."""


@dataclass(frozen=True)
class Config:
    """Write, check or describe the configuration of `synth`."""

    action: (
        Annotated[ConfigInit, subcommand("init")]
        | Annotated[ConfigCheck, subcommand("check")]
        | Annotated[ConfigFrame, subcommand("frame")]
        | Annotated[ConfigSchema, subcommand("schema")]
    )


@dataclass(frozen=True)
class Info:
    """Say what a dataset holds (frames by car, person, action and view), or a recording (sources, rates, gaps, losses).

    With --subject: the takes of a person in a folder of recordings.
    """

    dataset: ThingArgument
    """Folder of the dataset, or a recording (.mcap)."""
    verify: bool = False
    """Read every frame of a dataset, and so compare every checksum; of a recording they always are."""
    splits: SplitsFlag = None
    split: SplitFlag = None
    select: SelectFlag = ()
    subject: Maybe[str] = None
    """List the takes of this subject code in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class View:
    """Make pictures to judge a dataset or a recording by: a contact sheet (PNG) and a page (HTML, one file).

    Of a dataset the page browses frames; of a recording it shows time lines, rates, gaps and sample frames.
    """

    dataset: ThingArgument
    """Folder of the dataset, or a recording (.mcap)."""
    out: Path
    """Folder for contact_sheet.png and index.html."""
    frames: int = 24
    """Frames on the page, spread evenly over the dataset or take."""
    rows: int = 8
    """Frames on the contact sheet."""
    splits: SplitsFlag = None
    split: SplitFlag = None
    select: SelectFlag = ()
    overwrite: bool = False
    """Replace the pictures that are in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Evaluate:
    """Hold predictions, or models, against a dataset: a table by joint group, and with --out a page and report.json.

    Several predictions files and models are set side by side, on the joints that all of them answer for.
    """

    dataset: Annotated[Positional[Optional[Path]], several("[DATASET]")] = None
    """Folder of the dataset."""
    itop_npz: Maybe[Path] = None
    """ITOP frames (.npz with depth01, joints_3d, frame) to score one --model on, in place of a dataset."""
    predictions: Annotated[tuple[Path, ...], several("FILE [FILE ...]")] = ()
    """Predictions files (.jsonl or .parquet), one a model."""
    model: Annotated[tuple[str, ...], several("MODEL [MODEL ...]")] = ()
    """Models to run: names of those in the package, ONNX files, or addresses of models on servers (grpc://HOST:PORT/MODEL)."""
    persons: Annotated[tuple[str, ...], several("SLOT [SLOT ...]")] = ()
    """The people in these slots; default: in those that all models answer for."""
    out: Maybe[Path] = None
    """Folder for index.html and report.json."""
    splits: SplitsFlag = None
    split: SplitFlag = None
    select: SelectFlag = ()
    min_visibility: Literal["outside_image", "occluded", "self_occluded", "visible"] = "occluded"
    """Joints at least so visible count."""
    head: Literal["thesis", "true"] = "thesis"
    """Head size of PCKh: 26 px and 200 mm, or each person's own length from head to neck."""
    match: Literal["slot", "oks", "distance"] = "slot"
    """How predictions are matched to people: by seat, or by the assignment with the best OKS or the least distance."""
    presence: float = 0.5
    """From this probability on a joint counts as found."""
    pckh: tuple[float, ...] = (0.5, 1.0)
    """Thresholds of PCKh, in head sizes."""
    pck_px: tuple[float, ...] = (26.0,)
    """Thresholds of PCK in 2D, px."""
    pck_cm: tuple[float, ...] = (5.0, 10.0, 15.0, 20.0)
    """Thresholds of PCK in 3D, cm."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0 leaves them out."""
    seed: int = 0
    """Seed of the bootstrap."""
    everything: Annotated[bool, arg(name="all")] = False
    """Print every number, not only the usual eight; the page and the JSON always hold all."""
    overwrite: bool = False
    """Replace the report that is in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Train:
    """Train a detector on datasets, or on scenes generated meanwhile; the best epoch is kept.

    Needs the extra `train`. A run that was interrupted goes on with --resume from its last whole epoch.
    """

    out: Path
    """Folder of the run: best.ckpt, last.ckpt, log/metrics.csv."""
    datasets: Annotated[Positional[tuple[Path, ...]], several("[DATASET ...]")] = ()
    """Folders of the datasets to train on."""
    method: Maybe[str] = None
    """Method, if the configuration names none: compact, paf, lifting, unet."""
    config: Maybe[Path] = None
    """Configuration of the run (YAML); every key has a default."""
    synth: Maybe[Path] = None
    """Scene configuration (YAML) to generate frames from while training, in place of datasets."""
    frames: int = 2000
    """Frames an epoch with --synth."""
    splits: Maybe[Path] = None
    """YAML file of splits; without it some of the subjects of each dataset are held out to validate on."""
    train: str = "train"
    """Name of the split to learn from."""
    validate: str = "validate"
    """Name of the split to validate on."""
    devices: str = "auto"
    """Devices a machine, as Lightning understands them."""
    nodes: int = 1
    """Machines, started by Lightning's launchers."""
    init: Maybe[Path] = None
    """Checkpoint of an earlier run of the same network, whose weights this one begins with."""
    resume: bool = False
    """Go on with the run in the folder."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Models:
    """List the trained models that come with the package, or say all that is known of one."""

    model: Annotated[Positional[Optional[str]], several("MODEL")] = None
    """Name of a packaged model, or an ONNX file."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Predict:
    """Run a model over a dataset and write the joints that it finds, as a predictions file."""

    dataset: DatasetArgument
    model: str
    """Name of a packaged model, an ONNX file, or the address of a model on a server (grpc://HOST:PORT/MODEL)."""
    out: Path
    """Predictions file to write: JSON lines (.jsonl) or Parquet (.parquet)."""
    splits: SplitsFlag = None
    split: SplitFlag = None
    select: SelectFlag = ()
    overwrite: bool = False
    """Replace the file."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class BenchSynth:
    """Measure generation: frames a second, CPU time, threads, start-up, memory, and Blender on the same scenes."""

    frames: int = 400
    """Frames of each timed run."""
    repeats: int = 5
    """Rounds in which everything is measured once, one after the other; medians and quartiles are reported."""
    workers: int = 2
    """Threads, ours and Blender's."""
    skip_blender: bool = False
    """Leave the comparison out; it needs an environment of its own with bpy."""
    memory_frames: int = 0
    """Frames of a long run whose memory is watched; 0 leaves it out."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class BenchDetect:
    """Measure detectors on the CPU, from a camera's frame to joints, one frame at a time, with networks of others beside.

    The packaged models; and, with the extra `train`, `compact` and `paf` with default settings and fresh weights.
    """

    model: Annotated[tuple[str, ...], several("FILE [FILE ...]")] = ()
    """ONNX files of models to measure as well."""
    frames: int = 100
    """Frames of each timed run."""
    repeats: int = 3
    """Timed runs, of which the medians are reported."""
    threads: int = 2
    """Threads of ONNX Runtime."""
    skip_fresh: bool = False
    """Leave out the detectors with fresh weights."""
    skip_peers: bool = False
    """Leave out the networks of others."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class BenchRecord:
    """Measure recording: two ToF cameras and a suit, emulated, raw and decoded, into one file at a steady rate."""

    seconds: float = 120.0
    """Length of the take."""
    rate_mb: float = 160.0
    """MB/s that the sources give."""
    folder: Maybe[Path] = None
    """Folder on the disk to measure; default: that of temporary files. The recording is deleted again."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class BenchLab:
    """Measure ground truth: a virtual rig's errors, all together and each alone, in its calibration and in the joints."""

    errors: Annotated[tuple[str, ...], several("[ERROR [ERROR ...]]")] = ()
    """Errors to look at alone; default: all that the rig has."""
    views: int = 40
    """Poses of the checkerboard."""
    seconds: float = 20.0
    """Length of the driver's take."""
    seed: int = 0
    """Seed of what is drawn, the same for every error."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class BenchRemote:
    """Measure the way to a model on a server and back, over loopback, beside a bare echo server asked by Triton's client."""

    frames: int = 1000
    """Round trips of each way."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Bench:
    """Measure what the package promises on this machine."""

    action: (
        Annotated[BenchSynth, subcommand("synth")]
        | Annotated[BenchDetect, subcommand("detect")]
        | Annotated[BenchRecord, subcommand("record")]
        | Annotated[BenchLab, subcommand("lab")]
        | Annotated[BenchRemote, subcommand("remote")]
    )


@dataclass(frozen=True)
class EmulateMvn:
    """Stream a motion as Xsens MVN's network streamer does, with losses, delays and a wrong order as you ask. Ctrl-C ends it."""

    motion: str = "seated"
    """seated, walk, or an MVNX file to repeat."""
    host: str = "127.0.0.1"
    """Where to stream to (listen: where to be reached)."""
    port: int = 9763
    """Port there."""
    transport: Literal["udp", "tcp", "listen"] = "udp"
    """udp; tcp to a receiver that waits; listen for one that connects."""
    types: tuple[int, ...] = (2,)
    """Types of datagrams: 1 2 3 5 20 21 22 23 24 25. Names and scales (12, 13) come every second."""
    rate: float = 60.0
    """Samples a second."""
    capture_rate: Maybe[float] = None
    """Samples a second that the sample counter counts; default: the rate."""
    characters: int = 1
    """People, side by side."""
    props: int = 0
    """Props of each."""
    fingers: bool = False
    """With 40 finger segments."""
    items_per_datagram: Maybe[int] = None
    """Split samples over datagrams of so many items."""
    latency: float = 0.0
    """Seconds from taking a sample to sending it."""
    clock_offset: float = 0.0
    """What the sender's clock shows at the start, seconds."""
    clock_drift: float = 0.0
    """By how much the sender's clock runs fast, millionths."""
    loss: float = 0.0
    """Share of datagrams that are lost."""
    duplicate: float = 0.0
    """Share of datagrams that arrive twice."""
    reorder: float = 0.0
    """Share of datagrams that arrive late."""
    seconds: Maybe[float] = None
    """How long; default: until Ctrl-C."""
    log: Maybe[Path] = None
    """File for a line of JSON on each datagram and its fate."""
    seed: int = 0
    """Seed of what the network does."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class EmulateVicon:
    """Serve a motion as Vicon's DataStream does, to any number of clients. Ctrl-C ends it."""

    motion: str = "generated"
    """generated, or a C3D file to repeat."""
    host: str = "127.0.0.1"
    """Address to listen on."""
    port: int = 8801
    """Port to listen on; 0 takes a free one. Vicon's own is 801, which most systems keep for the administrator."""
    rate: Maybe[float] = None
    """Frames a second; default: the motion's (generated: 100)."""
    subjects: int = 1
    """People of a generated motion, side by side."""
    first_frame: int = 1
    """Number of the first frame, as the vendor's SDK tells it."""
    latency: float = 0.0
    """Seconds from a frame's capture to its sending, as the server reports them."""
    clock_drift: float = 0.0
    """By how much the server's clock runs fast, millionths."""
    drop: float = 0.0
    """Share of frames that are never sent."""
    occlude_markers: float = 0.0
    """Share of markers that are not seen."""
    occlude_segments: float = 0.0
    """Share of segments that are not solved."""
    up: Literal["z", "y"] = "z"
    """The server's vertical axis."""
    die_after: Maybe[float] = None
    """Die after so many seconds, and return."""
    dead_for: float = 2.0
    """Seconds until it returns."""
    anew: bool = False
    """When it returns, number frames from the first again."""
    seconds: Maybe[float] = None
    """How long; default: until Ctrl-C."""
    log: Maybe[Path] = None
    """File for a line of JSON on each frame for each client, and its fate."""
    seed: int = 0
    """Seed of the motion, and of what is dropped and occluded."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Emulate:
    """Play a device that is not there: a server that sends the real bytes, on loopback unless told otherwise."""

    device: Annotated[EmulateMvn, subcommand("mvn")] | Annotated[EmulateVicon, subcommand("vicon")]


Command = (
    Annotated[Synth, subcommand("synth")]
    | Annotated[Config, subcommand("config")]
    | Annotated[Car, subcommand("car")]
    | Annotated[Info, subcommand("info")]
    | Annotated[View, subcommand("view")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Import, subcommand("import")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[EvaluateMocap, subcommand("evaluate-mocap")]
    | Annotated[Train, subcommand("train")]
    | Annotated[Models, subcommand("models")]
    | Annotated[Predict, subcommand("predict")]
    | Annotated[Serve, subcommand("serve")]
    | Annotated[Emulate, subcommand("emulate")]
    | Annotated[Record, subcommand("record")]
    | Annotated[Recover, subcommand("recover")]
    | Annotated[Forget, subcommand("forget")]
    | Annotated[Calibrate, subcommand("calibrate")]
    | Annotated[Align, subcommand("align")]
    | Annotated[Lab, subcommand("lab")]
    | Annotated[Bench, subcommand("bench")]
)


VERBS = tuple(meta.name for each in get_args(Command) for meta in each.__metadata__)


def command_line(command: Annotated[Command, arg(name="")]) -> Any:
    """The command that was typed. A function: tyro looks in sources for what docstrings do not say of fields."""
    return command


RUNNERS = MappingProxyType(
    {
        Synth: "synth", Config: "config", Car: "car", Info: "info", View: "view", Export: "export", Evaluate: "evaluate",
        Train: "train",
        Models: "models", Predict: "predict", Bench: "bench", Import: "importing", Emulate: "emulate",
        Record: "record", Recover: "recover", Forget: "forget", Calibrate: "calibrate", Align: "align", Lab: "lab",
        EvaluateMocap: "evaluate_mocap", Serve: "serve",
    }
)  # fmt: skip

STYLE = (DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes)
