"""Parts of the corridor that say what may do harm to a reader, a terminal, a page or a CI log."""

from __future__ import annotations

import os

from corridor import Brake, Reckless, Watch

from pytest_dura import Assessed, Assessment, Proposal, Recovery

TEXT = (
    "</script><script>window.pwned=1</script>'\"><svg onload=alert(1)>]]>&lt;"
    "\x1b[31m\x9b2J\x07\x00\x7f\u202e\u2028\ufeff\r\n\n# Gate passed\ngate: passed\n"
    "| a |`@me #1 [x](javascript:alert(1))../../etc/passwd$(id)%s{0}"
    "\n::error::pwned\n \t::set-env name=x::y\r::stop-commands::z\x85::add-mask::a\n##[error]pwned "
    "##vso[task.setvariable variable=x]y "
)
SECRET = os.environ.get("HELD_API_KEY", "no secret here")


class Hostile(Reckless):
    def propose(self, view):
        if view.time > 0.25:
            raise ValueError(f"{TEXT} asked with {SECRET}")
        return Proposal(20.0, explanation=f"{TEXT} {SECRET}")


class Endless(Reckless):
    def propose(self, view):
        raise ValueError(TEXT * 500)


class Worries(Watch):
    def run(self, view):
        return Assessment(Assessed.UNSAFE, score=-1.0, reasons=(TEXT, SECRET))


class Dies(Watch):
    def run(self, view):
        raise RuntimeError(f"{TEXT} {SECRET}")


class Brakes(Brake):
    def run(self, view):
        return Recovery(0.0, TEXT, TEXT)
