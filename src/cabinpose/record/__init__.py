"""Devices recorded into one file with honest time stamps: sources that speak their protocols, emulators that play them."""
