"""The motion stage: recorded or synthetic markers and ground reactions become a `Trial`."""
