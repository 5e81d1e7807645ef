"""A server of the tank: tank_server.py ADDRESS BINDING [FILE DEATHS].

With a file it counts its lives there, and each of the first so many ends at the fifth command.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from pytest_dura import RoleSpec
from pytest_dura.adapters.link.bindings import Binding
from pytest_dura.adapters.link.conversation import Link
from pytest_dura.adapters.link.frames import Kind
from pytest_dura.adapters.link.serve import _Target, serve
from pytest_dura.adapters.link.transports import open_transport

address, binding, lives, deaths = [*sys.argv[1:], "", "0"][:4]
target = _Target(RoleSpec("tank:Tank"), Binding.read(binding))
life, commands = 1, 0
if lives:
    file = Path(lives)
    life = 1 + len(file.read_text().split()) if file.exists() else 1
    with file.open("a") as log:
        log.write(f"{os.getpid()}\n")


def answer(frame):
    global commands  # noqa: PLW0603 - of the process
    commands += frame.kind is Kind.COMMAND
    if commands == 5 and life <= int(deaths):
        os.write(1, b"the physics engine is out of memory\n")
        os._exit(3)
    return target.answer(frame)


link = Link(open_transport(address, peer=True))
while True:  # a session after the other
    serve(link, answer, 120.0)
