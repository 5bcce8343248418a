"""Memory that tiles use again is not handed back to the system in between."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

BLOCKS = """
import resource
import torch
from nqr_geom.integrator.memory import keep_blocks

keep_blocks()

def tile():
    held = [torch.empty(2**21).fill_(1.0) for _ in range(4)]  # 8 MiB each

for _ in range(10):
    tile()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    tile()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the C library of other systems decides by itself")
def test_blocks_of_a_tile_are_kept() -> None:
    # Whoever sets these decides for the C library; workers of dask that ran before in this process do.
    env = {key: value for key, value in os.environ.items() if not key.startswith("MALLOC_")}
    done = subprocess.run([sys.executable, "-c", BLOCKS], capture_output=True, text=True, check=True, env=env)
    assert int(done.stdout) < 1000
