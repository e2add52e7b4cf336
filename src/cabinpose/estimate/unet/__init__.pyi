from .segment import OnnxSegmenter as OnnxSegmenter
