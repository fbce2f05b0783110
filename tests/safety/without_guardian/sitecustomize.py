"""Guardians of processes with this folder on their path do nothing; so a test sees whether that is found out."""

from __future__ import annotations

import sys

if any(argument.endswith("hardware.guardian.process") for argument in sys.orig_argv):
    sys.stdin.readline()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.read()
    raise SystemExit
