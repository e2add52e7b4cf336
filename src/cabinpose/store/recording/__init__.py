"""Recordings: MCAP files of what devices said, raw and decoded. See docs/recording.md."""

from cabinpose.store.recording.container import Compression
from cabinpose.store.recording.files import files_of_take, part_path, parts_beside
from cabinpose.store.recording.folder import TakeFile, erase, takes_in
from cabinpose.store.recording.reader import Place, Recording
from cabinpose.store.recording.recover import Recovered, recover
from cabinpose.store.recording.scan import Damage
from cabinpose.store.recording.schemas import SourceStatus
from cabinpose.store.recording.series import MarkerSeries, SegmentSeries, marker_series, segment_series, tof_frames
from cabinpose.store.recording.survey import SourceSurvey, Survey, TopicSurvey, survey
from cabinpose.store.recording.take import Participant, Take
from cabinpose.store.recording.writer import RecordingWriter

__all__ = [
    "Compression", "Damage", "MarkerSeries", "Participant", "Place", "Recording", "RecordingWriter", "Recovered",
    "SegmentSeries", "SourceStatus", "SourceSurvey", "Survey", "Take", "TakeFile", "TopicSurvey", "erase", "files_of_take",
    "marker_series", "part_path", "parts_beside",
    "recover", "segment_series", "survey", "takes_in", "tof_frames",
]  # fmt: skip
