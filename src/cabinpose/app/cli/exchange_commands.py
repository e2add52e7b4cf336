"""What can be typed about other formats; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Optional

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import JsonFlag, Maybe, SelectFlag, SplitFlag, several


@dataclass(frozen=True)
class Export:
    """Write a dataset or a recording in another format, or a trained model as ONNX.

    Datasets: png-json, coco, yolo, itop, ntu, ply. Recordings: c3d, bvh, trc, sto, csv.
    """

    out: Path
    """Folder (recordings but for csv, and --onnx: file) to write; it appears when the export is whole."""
    dataset: Annotated[Positional[Optional[Path]], several("DATASET|RECORDING")] = None
    """Folder of the dataset, or a recording (.mcap)."""
    format: Maybe[str] = None
    """Format to write; see above and docs."""
    onnx: Maybe[Path] = None
    """Checkpoint of `cabinpose train` to write as an ONNX model, in place of a dataset."""
    name: Maybe[str] = None
    """Name of the ONNX model in reports; default: the file's."""
    card: Maybe[Path] = None
    """YAML file of what is known of the model (data, seeds, metrics, limits), kept in the ONNX file."""
    mirrored: bool = False
    """The ONNX model answers with the mean over a frame and its mirror image: smaller errors, at twice the time."""
    images: Maybe[Literal["depth8", "amplitude8", "depth16"]] = None
    """coco, yolo: what the pictures show, in 8 bits of grey or (coco) 16 bits of millimetres; default: depth8."""
    splits: Annotated[Optional[Path], several("FILE")] = None
    """YAML file of splits, of which --split names one; coco, yolo: without --split all of them, each by itself."""
    split: SplitFlag = None
    select: SelectFlag = ()
    source: Annotated[tuple[str, ...], several("NAME [NAME ...]")] = ()
    """Recordings: sources to export; default: all, or the only one that has what the format holds."""
    subject: Maybe[str] = None
    """Recordings: whose data (c3d, bvh, trc, sto); needed where there are several."""
    span: Annotated[Optional[tuple[float, float]], several("FROM TO")] = None
    """Recordings: seconds from the start of the take."""
    rate: Maybe[float] = None
    """Recordings: frames a second (c3d, trc, sto); default: what the device told, or the median."""
    angles: bool = False
    """sto: joint angles in place of orientations."""
    overwrite: bool = False
    """Replace what is there."""
    as_json: JsonFlag = False


@dataclass(frozen=True)
class Import:
    """Make a dataset of one in another format, or a recording of another tool's file.

    Datasets: png-json (an export of ours), coco, itop, ntu. Recordings: mvnx, c3d, bvh, adtfdat, xdf, azure-mkv.
    """

    source: Annotated[Positional[Path], arg(metavar="SOURCE")]
    """Folder or file to read."""
    format: str
    """Format of the source; see above and docs."""
    out: Path
    """Folder of the dataset, or recording (.mcap); it appears when the import is whole."""
    images: Maybe[Path] = None
    """coco: folder of the images; default: `images` beside `annotations`, else joints only."""
    keep_invalid: bool = False
    """itop: keep the frames whose labels are marked as not valid, without their joints."""
    intrinsics: Maybe[tuple[float, float, float, float]] = None
    """Datasets: fx fy cx cy of the camera in px, in place of those of the source."""
    licence: Maybe[str] = None
    """Datasets: licence of the data; default: what the source says."""
    subject: Annotated[tuple[str, ...], several("CODE [CODE ...]")] = ()
    """Recordings: codes of the subjects, in the order of the file."""
    action: Maybe[str] = None
    """Recordings: what is done, as a short word."""
    car: Maybe[str] = None
    """Recordings: the car or mock-up."""
    take: Maybe[Path] = None
    """Recordings: YAML file of the take, in place of --subject, --action and --car."""
    name: Maybe[str] = None
    """Recordings: name of the source (mvnx, c3d, bvh, azure-mkv); default: suit, optical, motion or tof."""
    begun: Maybe[str] = None
    """c3d, bvh: when it was recorded (2026-11-21T14:30:00+01:00); default: 1970, since the files do not tell."""
    unit_m: Maybe[float] = None
    """bvh: metres of the unit of length; default: that of the CMU database."""
    up: Maybe[Literal["x", "-x", "y", "-y", "z", "-z"]] = None
    """c3d, bvh (y or z): the axis that points up; default: as the markers tell, or the file; bvh: y."""
    keep_whole_frames: bool = False
    """c3d: take the frames that are whole of a file that is cut off, and say how many are lost."""
    overwrite: bool = False
    """Replace what is there."""
    as_json: JsonFlag = False
