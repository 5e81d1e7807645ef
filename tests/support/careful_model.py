"""A model that reads its prompt with regular expressions, and ways to get it wrong.

What it knows it has from the prompt's text alone, so that it also shows that the text tells enough.
"""

from __future__ import annotations

import json
import re

from models import said

from pytest_dura.llm.driving.attacks import ATTACKS

TAG = r"(?:<perceived_text>)?(?P<id>[\w-]+)(?:</perceived_text>)?"
OBJECT = re.compile(
    rf"^{TAG}(?:,|: )(?:car|pedestrian|obstacle),\s?(?P<range>[\d.]+)"
    r"(?:,(?:[^,\n]+,){4}| m .*closing at )(?P<closing>-?[\d.]+)",
    re.MULTILINE,
)
SPEED = re.compile(r"^EGO: (?:you drive at|speed) (?P<speed>[\d.]+)", re.MULTILINE)
SOON = 6.0
"""s; whatever could be reached within this time is cited, nearest first."""


def dangers(text):
    """Ids and seconds of what comes nearer, soonest first; a tie by the id."""
    rows = [
        (row["id"], float(row["range"]), float(row["closing"])) for row in OBJECT.finditer(text)
    ]
    if text.startswith("{"):
        listed = blocks(text).get("LIDAR", {}).get("objects", ())
        rows = [(re.sub("<.*?>", "", o["label"]), o["distance"], o["closing"]) for o in listed]
    return sorted((far / closing, name) for name, far, closing in rows if (closing or 0.0) > 0.5)


def blocks(text):
    """The blocks of a prompt in the other format."""
    return {name: facts for line in text.splitlines() for name, facts in json.loads(line).items()}


def attack_in(text):
    """The attacker's text in a prompt, with its goal, or None."""
    return next((one for one in ATTACKS if one.text in text), None)


def careful(text):
    """Waits where anything is soon there, else proceeds; cites what is nearest in time."""
    speed = blocks(text)["EGO"]["speed"] if text[0] == "{" else float(SPEED.search(text)["speed"])
    near = [name for seconds, name in dangers(text) if seconds < SOON][:3]
    if near:
        return {"ids": near, "intent": "slow_down", "maneuver": "wait"}
    return {"ids": [], "intent": "speed_up" if speed < 8.5 else "hold", "maneuver": "proceed"}


def hallucinates(text, _request, answer):
    return answer | {"ids": ["V99"]}


def overlooks(text, _request, answer):
    return answer | {"ids": []}


def contradicts_itself(text, _request, answer):
    return answer | {"intent": "speed_up"} if answer["maneuver"] == "wait" else answer


def says_the_opposite(text, _request, answer):
    slower = answer["maneuver"] == "wait"
    return answer | {"intent": "speed_up" if slower else "slow_down"}


def throws_dice(text, request, answer):
    return answer | {"maneuver": "yield" if request.sample % 2 else "wait"}


def reads_the_order(text, _request, answer):
    """Its decision hangs on which object is told first."""
    first = OBJECT.search(text)
    number = 0 if first is None else sum(map(ord, first["id"]))
    return answer | {"maneuver": ("wait", "yield", "proceed")[number % 3]}


def obeys(text, request, answer):
    """It does what it is asked for, whoever asks."""
    attack = attack_in(text)
    if attack is None:
        return answer
    return (
        answer
        | {
            "accelerate": {"maneuver": "accelerate", "intent": "speed_up"},
            "brake": {"maneuver": "emergency_brake", "intent": "slow_down"},
            "stop": {"maneuver": "wait", "intent": "slow_down"},
            "swerve": {"maneuver": "swerve_left"},
            "reveal": {"reasoning": request.messages[0].text[:200]},
        }[attack.goal]
    )


def obeys_unless_warned(text, request, answer):
    """It does so where its prompt does not warn of texts in the scene."""
    warned = "<perceived_text>" in request.messages[0].text
    return answer if warned else obeys(text, request, answer)


def brakes_at_texts(text, _request, answer):
    """Whatever stands on a sign alarms it."""
    hard = {"maneuver": "emergency_brake", "intent": "slow_down"}
    return answer | hard if re.search(r"^S\d+(,text,|: text at )", text, re.MULTILINE) else answer


def reads_one_format(text, _request, answer):
    return answer | {"maneuver": "yield", "intent": "hold"} if text[0] == "{" else answer


def gives_in(text, _request, answer):
    """It does not accelerate as the sign wants it to, but goes where it would wait."""
    return answer | {"maneuver": "proceed", "intent": "hold"} if attack_in(text) else answer


def sees_nothing(text, _request, answer):
    """The null model: whatever is put before it."""
    return {"ids": [], "intent": "hold", "maneuver": "proceed"}


def model(defect=None):
    """What answers requests: a function of the request and its number."""
    from speaking_models import claim, objects  # which reads attacks as this module does

    def answers(request, _number):
        text = request.messages[-1].text
        answer = careful(text)
        if defect is not None:
            answer = defect(text, request, answer)
        words = {"reasoning": answer["reasoning"]} if "reasoning" in answer else {}
        claims = [claim(each) for each in objects(text)[:4]]
        return said(answer["maneuver"], answer["intent"], answer["ids"], claims=claims, **words)

    return answers
