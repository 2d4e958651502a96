"""The start page: recent work, scans and recipes on this machine, sample cases."""
