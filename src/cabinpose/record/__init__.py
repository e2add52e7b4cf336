"""Devices recorded into one file with honest time stamps: sources that speak their protocols, emulators that play them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
