"""The fault catalogue: what can go wrong, and the proof that the vine is safe then.

`catalogue` is the table of docs/faults.md; every row of it has a test that injects the fault into the whole
(service or core, link, firmware, plant, fake autopilot) and watches the valves through a black box.
"""
