"""`flying-vines diagnose CASE` in a process of its own: processor time and peak memory, start included.

`discrepancy_cases.py` starts it. The process reads its own peak memory. From outside, the peak would include
the memory of the parent, if that is larger.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys

from process_cost import cpu_s, memory

from flying_vines.cli.main import main


def run(case: str) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            main(["diagnose", case, "--json"])
        except SystemExit as ended:
            if ended.code:
                raise
    print(json.dumps({"cpu_s": cpu_s(os.getpid()), "peak_MB": memory(os.getpid()).peak_MB}))


if __name__ == "__main__":
    run(sys.argv[1])
