"""The command line: one thin file a command, run as `python scripts/<command>.py`."""
