"""Detectors in other processes, asked by the Open Inference Protocol v2 over gRPC. Needs the extra `remote`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
