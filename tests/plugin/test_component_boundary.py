"""Whatever a component, a role or a simulator raises, returns or does to the process is judged.

No waiver comes out of the loop, no session ends in it, and none reads as a success that did.
"""

from __future__ import annotations

import os
import re
import signal

import pytest
from corridors import expect, requirement, scenario
from outputs import output

from pytest_dura.__main__ import main

EXECUTOR = "auto"

PARTS = """
import asyncio, ctypes, os, signal, sys
import numpy as np
import pytest
from corridor import Brake, Careful, Corridor, Watch
from pytest_dura import Alert, Assessed, Assessment, Proposal, SecurityAssessment, SecurityAssessor

class OwnError(BaseException):
    pass

class Unreadable(BaseException):
    def __str__(self):
        pytest.skip("nor is its text")
    __repr__ = __str__

class Text(str):
    def _refuse(self, *_):
        raise OwnError("this text is not to be read")
    __hash__ = __eq__ = __str__ = __repr__ = __len__ = __format__ = __add__ = __iter__ = _refuse

class Entries(dict):
    def _refuse(self, *_):
        raise OwnError("these entries are not to be read")
    items = keys = values = get = __getitem__ = __iter__ = __len__ = __repr__ = _refuse

class Number(float):
    def _refuse(self, *_):
        raise OwnError("this number is not to be read")
    __float__ = __add__ = __mul__ = __eq__ = __lt__ = __le__ = __gt__ = __ge__ = _refuse
    __hash__ = __repr__ = __str__ = __format__ = __int__ = __bool__ = _refuse

class Thing:
    def _refuse(self, *_):
        raise OwnError("this thing is not to be read")
    __hash__ = __eq__ = __str__ = __repr__ = __float__ = __getattr__ = __bool__ = _refuse

class Many(Proposal):
    def __getattribute__(self, name):
        pytest.xfail("there is none")

def end_in_c():
    ctypes.CDLL(None)._exit(0)

DEEDS = {
    "xfail": lambda: pytest.xfail("too hard"),
    "skip": lambda: pytest.skip("too cold"),
    "exit": lambda: pytest.exit("enough", returncode=0),
    "fail": lambda: pytest.fail("no"),
    "cancelled": lambda: raised(asyncio.CancelledError()),
    "generator exit": lambda: raised(GeneratorExit()),
    "interrupt": lambda: raised(KeyboardInterrupt()),
    "system exit": lambda: sys.exit(0),
    "own": lambda: raised(OwnError("of its own")),
    "unreadable": lambda: raised(Unreadable()),
    "os._exit": lambda: os._exit(0),
    "posix._exit": lambda: sys.modules[os.name]._exit(0),
    "execv": lambda: os.execv("/bin/true", ["true"]),
    "fork": lambda: os.fork(),
    "C": end_in_c,
    "text": lambda: Proposal(1.0, Text("why")),
    "failing text": lambda: Proposal(1.0, failure=Text("why")),
    "number": lambda: Proposal(Number(1.0), latency=Number(0.1)),
    "entries": lambda: Proposal(1.0, account=Entries(decided=True)),
    "things": lambda: Proposal([Thing()]),
    "thing": lambda: Proposal(Thing()),
    "thing key": lambda: Proposal(1.0, account={Thing: 1}),
    "latency": lambda: Proposal(1.0, latency=10**5000),
    "no latency": lambda: Proposal(1.0, latency=float("nan")),
    "large": lambda: Proposal(10**5000),
    "infinite": lambda: Proposal([1.0, float("inf")]),
    "nested": lambda: Proposal(nested()),
    "many": lambda: Many(1.0),
    "unmade": lambda: object.__new__(Proposal),
    "array": lambda: Proposal(np.array([1.0, np.nan])),
}

def raised(error):
    raise error

def nested():
    value = []
    value.append(value)
    return value

def do(name):
    return DEEDS[name]()

class Component(Careful):
    deed = ""
    def propose(self, view):
        proposal = super().propose(view)
        if view.index != 2:
            return proposal
        made = do(self.deed)
        return made if issubclass(type(made), Proposal) else proposal

class Swallowing(Component):
    def propose(self, view):
        try:
            return super().propose(view)
        except BaseException:
            return Proposal(1.0)

class Begins(Careful):
    deed = ""
    def reset(self, context):
        do(self.deed)

class Made(Careful):
    deed = ""
    def __init__(self):
        do(self.deed)

class Monitor(Watch):
    deed = ""
    def run(self, view):
        if view.index == 2:
            do(self.deed)
        return super().run(view)

class Alarming(Watch):
    def run(self, view):
        return SecurityAssessment(alerts=(Alert(Text("p"), Text("s"), Text("d")),),
                                  reasons=(Text("r"),))

class Step(Corridor):
    deed = ""
    def step(self, action):
        do(self.deed)
        return super().step(action)

class Signals(Corridor):
    deed = ""
    def signals(self, ticks):
        do(self.deed)
        return super().signals(ticks)

class Close(Corridor):
    deed = ""
    def close(self):
        do(self.deed)

for base in (Component, Swallowing, Begins, Made, Monitor, Step, Signals, Close):
    for number, deed in enumerate(DEEDS):
        name = f"{base.__name__}{number}"
        globals()[name] = type(name, (base,), {"deed": deed, "__module__": __name__})

def check(episode):
    do("xfail")
"""
DEEDS = re.findall(
    r'^    "([^"]+)": lambda', PARTS.replace('"C": end_in_c', '"C": lambda'), re.MULTILINE
)


def path(kind, deed):
    """Where the class is that does it."""
    return f"hostile:{kind}{DEEDS.index(deed)}"


def slug(text):
    return re.sub("[^a-z]+", "-", text.lower())


def events(project):
    """What the record says of each component: tick and detail of its first failure."""
    found = {}
    for episode in project.evidence().episodes:
        for event in episode.events:
            if event.kind == "component_failure":
                found.setdefault(episode.case, []).append((event.tick, event.detail))
    return found


def quiet(result):
    text = output(result)
    assert "INTERNALERROR" not in text
    assert "Traceback" not in text
    return text


RAISES = {
    "xfail": "raised XFailed: too hard (",
    "skip": "raised Skipped: too cold (",
    "exit": "raised Exit: enough (",
    "fail": "raised Failed: no (",
    "cancelled": "raised CancelledError (hostile.py:",
    "generator exit": "raised GeneratorExit (hostile.py:",
    "interrupt": "raised KeyboardInterrupt (hostile.py:",
    "system exit": "raised SystemExit: 0 (hostile.py:",
    "own": "raised OwnError: of its own (hostile.py:",
    "unreadable": "raised Unreadable: (its message cannot be read) (",
    "thing": "no valid action: the action holds an object of type Thing; a simulator that takes",
    "things": "no valid action: the action holds an object of type Thing; a simulator that takes",
    "thing key": "gave an account that is no plain data: TypeError: keys must be",
    "latency": "declared a latency of <int>, which is no",
    "no latency": "declared a latency of nan, which is not a duration",
    "large": "no valid action: the action <int> is no fin",
    "infinite": "no valid action: the action inf is no finite number",
    "nested": "no valid action: it holds more than 32 containers within each other",
    "unmade": "raised AttributeError: ",
    "failing text": "why",
    "entries": "raised OwnError: these entries are not to be read (hostile.py:",
    "array": "no valid action: the action array([ 1., nan]) holds what is no finite number",
}  # fmt: skip
FINE = ["text", "number", "many"]


SOME = ["xfail", "interrupt", "own", "thing", "text"]


@pytest.mark.parametrize(
    "deeds, mode",
    [([*RAISES, *FINE], []), (SOME, ["-n", "2"])],
    ids=["processes", "n2"],
)
def test_whatever_a_component_does_is_judged_and_its_episode_goes_on(project, deeds, mode):
    project.write("hostile.py", PARTS)
    for deed in deeds:
        generator = path("Component", deed)
        scenario(project, f"d-{slug(deed)}", generator=generator, runs=1, requirements="[GAP-1]")
    result = project.scenarios(*mode, select="corridor/d-*")
    quiet(result)
    result.assert_outcomes(passed=len(deeds))
    told = {f"corridor/d-{slug(deed)}": RAISES[deed] for deed in deeds if deed in RAISES}
    found = events(project)
    assert found.keys() == told.keys()
    for case, detail in told.items():
        ((tick, text),) = found[case]
        assert tick == 2
        assert text.startswith(detail)
    record = project.evidence()
    assert {episode.validity for episode in record.episodes} == {"valid"}
    assert {verdict.verdict for verdict in record.verdicts} == {"supported"}
    assert [one for one in record.verdicts if one.waiver is not None] == []
    assert (result.ret, record.status) == (0, "complete")


@pytest.mark.parametrize("deed", ["xfail", "own"])
def test_a_component_that_fails_where_it_begins(project, deed):
    project.write("hostile.py", PARTS)
    scenario(project, "a", generator=path("Begins", deed), runs=1, requirements="[GAP-1]")
    scenario(project, "b", generator=path("Made", deed), runs=1, requirements="[GAP-1]")
    result = project.run("corridor/a", "corridor/b")
    text = quiet(result)
    result.assert_outcomes(passed=0, failed=2)
    assert result.ret == 1
    found = events(project)["corridor/a"]
    assert found[0][1].removeprefix("reset ").startswith(RAISES[deed])
    assert found[1][1] == "not called: its reset failed"
    assert f"{path('Made', deed)} cannot be built: " in text


ROLES = {"a": "Monitor", "b": "Step", "c": "Signals", "d": "Close"}


def test_roles_and_simulators_make_an_episode_missing(project):
    project.write("hostile.py", PARTS)
    deeds = ("xfail", "interrupt")
    for deed in deeds:
        for name, kind in ROLES.items():
            role = {"monitor" if name == "a" else "simulator": path(kind, deed)}
            case = f"r-{slug(deed)}-{name}"
            scenario(project, case, runs=1, requirements="[GAP-1]", **role)
    scenario(project, "r-e", monitor="hostile:Alarming", runs=1, requirements="[GAP-1]")
    result = project.scenarios(select="corridor/r-*")
    quiet(result)
    result.assert_outcomes(failed=len(deeds) * len(ROLES), passed=1)
    record = project.evidence()
    failures = {episode.case: episode.failure for episode in record.episodes}
    assert failures.pop("corridor/r-e") is None
    for deed in deeds:
        for name in ROLES:
            failure = failures[f"corridor/r-{slug(deed)}-{name}"]
            who = "safety_monitor at tick 2" if name == "a" else "simulator at tick "
            assert failure.startswith(f"infrastructure: {who}")
            assert RAISES[deed].removeprefix("raised ") in failure
    assert {one.verdict for one in record.verdicts} == {"undecided", "supported"}
    assert result.ret == 1


def test_a_check_that_skips_is_infrastructure(project):
    project.write("hostile.py", PARTS)
    requirement(project, "hostile:check")
    scenario(project, requirements="[R-1]", runs=1)
    result = project.run("corridor/it")
    reason = "infrastructure: check hostile:check: XFailed: too hard ("
    assert reason in quiet(result)
    expect(project, result, "undecided")


def test_a_copy_that_comes_back_to_pytest_writes_no_evidence(project):
    scenario(project, runs=1, requirements="[GAP-1]")
    project.write(
        "test_it.py",
        "import os\nfrom pathlib import Path\n"
        "def test_it(orchestrator):\n"
        "    child = os.fork()\n"
        "    if child: Path('child').write_text(str(child))\n"
        "    orchestrator.run('corridor/it')\n",
    )
    assert project.run("test_it.py").ret == 0
    child = int((project.path / "child").read_text())
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 70
    assert len(project.evidence().episodes) == 1


@pytest.mark.parametrize("deed", ["os._exit", "posix._exit", "execv"])
def test_the_end_of_the_sessions_own_process_is_no_success(project, deed):
    project.write("hostile.py", PARTS)
    scenario(project, generator=path("Component", deed), runs=1, requirements="[GAP-1]")
    result = project.pytester.runpytest_subprocess("corridor/it", "--dura-executor=in-process")
    what = "os.execv" if deed == "execv" else "os._exit"
    assert f"dura: {what} was called while a session ran: exit code 70" in output(result)
    assert (result.ret, project.evidence().status) == (70, "running")
    assert main(["verify", str(project.path / "dura-evidence")]) != 0


LATER = """
import os, threading
from corridor import Careful

class Leaves(Careful):
    def __del__(self):
        os._exit(0)

class Starts(Careful):
    def reset(self, context):
        thread = threading.Thread(target=lambda: os._exit(0))
        thread.start()
        thread.join()
"""


@pytest.mark.parametrize("name", ["Leaves", "Starts"])
def test_what_a_component_leaves_behind_ends_no_session_with_a_success(project, name):
    project.write("later.py", LATER)
    scenario(project, generator=f"later:{name}", runs=1, requirements="[GAP-1]")
    result = project.pytester.runpytest_subprocess("corridor/it")
    assert result.ret != 0
    assert project.evidence().gate.result != "passed"


def test_the_process_is_as_it_was_after_a_session(project):
    before = os._exit, os.execv, signal.getsignal(signal.SIGINT)
    scenario(project, runs=1, requirements="[GAP-1]")
    assert project.run("corridor/it").ret == 0
    assert (os._exit, os.execv, signal.getsignal(signal.SIGINT)) == before
