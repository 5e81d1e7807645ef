from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.fixture
def digests(project):
    """Runs one episode in another process and returns the digests of its evidence."""

    def run(*arguments, **environment):
        command = [sys.executable, "-m", "pytest", "-q", "--dura-runs=1", *arguments]
        subprocess.run(
            [*command, "intersection/trajectory-spoofing::SAF-1"],
            cwd=project.path,
            env={**os.environ, **environment},
            check=False,
            capture_output=True,
        )
        return {one.id: one.digest for one in project.evidence().episodes}

    return run


def test_an_episode_has_one_digest_in_every_process(project, digests):
    there = digests(PYTHONHASHSEED="2")
    assert list(there) == ["intersection/trajectory-spoofing#0"]
    project.run("intersection/nominal::SAF-1", "intersection/trajectory-spoofing", "--dura-runs=1")
    here = {one.id: one.digest for one in project.evidence().episodes}
    assert {"intersection/nominal#0", *there} <= here.keys()
    assert there.items() <= here.items()
    assert project.run("--dura-replay=intersection/trajectory-spoofing#0").ret == 0
