"""Recordings that were cut short, as where the program that writes one is killed."""

import json
import shutil

from heartcase.schemas.recording.header import HEADER_NAME, LOG_NAME


def cut_short(recording, to, part=0.6):
    """A copy of a recording as a killed program leaves it: no end in its header, and its log torn off in a line."""
    shutil.copytree(recording, to)
    header = json.loads((to / HEADER_NAME).read_text())
    header["end"] = None
    (to / HEADER_NAME).write_text(json.dumps(header))
    log = (to / LOG_NAME).read_bytes()
    (to / LOG_NAME).write_bytes(log[: int(part * len(log))])
    return to
