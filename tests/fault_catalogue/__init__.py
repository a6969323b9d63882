"""The fault catalogue: all faults, and tests that the vine is safe after each.

`catalogue` is the table of docs/faults.md. A test injects each row's fault into the whole system (service or
core, link, firmware, plant, fake autopilot) and records the valves with a black box.
"""
