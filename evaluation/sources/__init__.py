"""Devices of the laboratory behind one small protocol: marker systems, force plates, streams, replay."""
