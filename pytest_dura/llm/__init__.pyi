from .answers import answer_schema, read_answer
from .cassette import Cassette
from .client import OpenAiClient
from .driving.blocks import BLOCKS, MOST, MOST_SIGNS, driving_prompt, percept_prompt
from .driving.planner import INTENTS, MANEUVERS, driving_templates, with_conflict, with_injection
from .endpoint import Endpoint
from .port import Answer, Delivery, Image, Message, Request, ServerFault
from .prompts import PerceivedText, Prompt, harmless, reordered
from .session import ModelSession
from .settings import EVERYTHING

__all__ = [
    "BLOCKS",
    "EVERYTHING",
    "INTENTS",
    "MANEUVERS",
    "MOST",
    "MOST_SIGNS",
    "Answer",
    "Cassette",
    "Delivery",
    "Endpoint",
    "Image",
    "Message",
    "ModelSession",
    "OpenAiClient",
    "PerceivedText",
    "Prompt",
    "Request",
    "ServerFault",
    "answer_schema",
    "driving_prompt",
    "driving_templates",
    "harmless",
    "percept_prompt",
    "read_answer",
    "reordered",
    "with_conflict",
    "with_injection",
]
