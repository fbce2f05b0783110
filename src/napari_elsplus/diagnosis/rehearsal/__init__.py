"""Rehearsal of faults: each is injected into the simulated rig's devices or processes, and the promises are tested.

Window, engine, card and guardian are processes of their own, as in use. The results are those of the card's log and of
the recorded file, not what the software under test reports.
"""
