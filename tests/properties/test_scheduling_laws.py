"""Items over the workers of pytest-xdist: each is run once, a scenario on one worker, no wait."""

from __future__ import annotations

import json
from collections import Counter
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.plugin.session.xdist import MAX_DEATHS, ScenarioScheduling

SUBJECTS = st.none() | st.tuples(st.sampled_from("abcd"), st.sampled_from(["", "+f", "#1"])).map(
    lambda pair: (pair[0], "".join(pair))
)
ITEMS = st.lists(SUBJECTS, min_size=1, max_size=30)
laws = settings(derandomize=True, deadline=None)


class Worker:
    """As a worker of pytest-xdist: it runs an item once it knows the next one, or the end."""

    def __init__(self, number):
        self.gateway = SimpleNamespace(id=f"gw{number}")
        self.queue, self.ran = [], []
        self.shutting_down = False

    def send_runtest_some(self, indices):
        assert not self.shutting_down
        self.queue += indices

    def shutdown(self):
        self.shutting_down = True

    @property
    def can_run(self):
        return len(self.queue) > (0 if self.shutting_down else 1)


class Session:
    """A session over so many workers, of whom those die that run one of the deadly items."""

    def __init__(self, folder, subjects, workers, deadly=()):
        folder.mkdir(exist_ok=True)
        (folder / "subjects.json").write_text(json.dumps(subjects))
        self.names = [f"item {number}" for number in range(len(subjects))]
        options = {"maxschedchunk": None, "tx": ["popen"] * workers}
        config = SimpleNamespace(getoption=options.get, getvalue=options.get)
        self.scheduler = ScenarioScheduling(config, None, folder)
        self.deadly, self.all, self.working = deadly, [], []
        self.crashed, self.given_up = [], []
        for _ in range(workers):
            self.add()

    def add(self):
        worker = Worker(len(self.all))
        self.all.append(worker)
        self.working.append(worker)
        self.scheduler.add_node(worker)
        self.scheduler.add_node_collection(worker, self.names)
        if self.scheduler.collection_is_completed:
            self.scheduler.schedule()

    def run(self, choose):
        """Let workers go on in any order until none can."""
        while able := [one for one in self.working if one.can_run]:
            worker = choose(able)
            index = worker.queue.pop(0)
            worker.ran.append(index)
            if index in self.deadly:
                self.working.remove(worker)
                self.crashed.append(self.scheduler.remove_node(worker))
                self.given_up += self.scheduler.given_up
                self.add()
            else:
                self.scheduler.mark_test_complete(worker, index, choose([0.0, 1.0]))
            if self.scheduler.tests_finished:
                for one in self.working:
                    one.shutdown()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("subjects")


@laws
@given(ITEMS, st.integers(1, 5), st.data())
def test_each_item_is_run_once_and_a_scenario_on_one_worker(folder, subjects, workers, data):
    session = Session(folder, subjects, workers)
    session.run(lambda choices: data.draw(st.sampled_from(choices)))
    ran = [index for worker in session.all for index in worker.ran]
    assert sorted(ran) == list(range(len(subjects)))
    workers_of = {
        (subjects[index][0], worker.gateway.id)
        for worker in session.all
        for index in worker.ran
        if subjects[index]
    }
    assert max(Counter(name for name, _ in workers_of).values(), default=1) == 1
    if None not in subjects:
        busy = min(workers, len({name for name, _ in subjects}))
        assert sum(bool(worker.ran) for worker in session.all) == busy


@laws
@given(ITEMS, st.integers(1, 4), st.data())
def test_who_dies_costs_its_item_and_two_workers_the_others_on_the_same(
    folder, subjects, workers, data
):
    every = range(len(subjects))
    deadly = data.draw(st.sets(st.sampled_from(every), max_size=3))
    deadly |= {index for index in every if subjects[index] and subjects[index] == subjects[-1]}
    session = Session(folder, subjects, workers, deadly)
    session.run(lambda choices: data.draw(st.sampled_from(choices)))
    ran = [index for worker in session.all for index in worker.ran]
    given_up = [int(name.split()[1]) for name in session.given_up]
    assert sorted([*ran, *given_up]) == list(every), "none is lost, and none tried again"
    assert {int(name.split()[1]) for name in session.crashed} == deadly - set(given_up)
    deaths = Counter(subjects[index] for index in ran if index in deadly and subjects[index])
    if any(subjects):
        assert max(deaths.values(), default=0) <= MAX_DEATHS
        assert {subjects[index] for index in given_up} <= {
            subject for subject, count in deaths.items() if count == MAX_DEATHS
        }


def test_a_worker_that_takes_over_scenarios_of_one_item_each_runs_them_all(folder):
    session = Session(folder, [("a", "a"), ("b", "b"), ("c", "c"), ("d", "d")], 1, {0})
    session.run(lambda choices: choices[0])
    assert [sorted(worker.ran) for worker in session.all] == [[0], [1, 2, 3]]
