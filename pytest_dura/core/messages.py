"""Messages: what the component sends through the loop, past the active faults of its channels."""

from __future__ import annotations

from typing import Any

from pytest_dura.core.boundary import CallEnded, let_pass
from pytest_dura.core.errors import describe_error
from pytest_dura.core.outputs import check_texts, exact_texts
from pytest_dura.core.outside import OutsideError, told
from pytest_dura.core.roles import FaultInjector
from pytest_dura.core.state import StateManager


class Messages:
    """The way of a component's own messages, such as prompts to a language model.

    The component calls :meth:`transmit` from within its proposal. A failure of the injector there
    says nothing about the component, whatever it makes of the error.

    Args:
        injector: Whose faults act on the messages; ``None`` without any.
        state: Where the faults that changed a message are noted.
    """

    def __init__(self, injector: FaultInjector | None, state: StateManager) -> None:
        self._injector, self._state = injector, state

    def transmit(self, channel: str, message: Any) -> Any:
        """The message as it arrives."""
        if self._injector is None:
            return message
        try:
            changed, tampered = self._injector.corrupt_message(
                channel, message, self._state.tick.time
            )
            check_texts("tampered faults", tampered)
            faults = exact_texts(tampered)
        except CallEnded:
            raise
        except BaseException as error:
            let_pass(error)
            raise told(OutsideError("fault_injector", describe_error(error))) from error
        self._state.message_faults.update(faults)
        return changed
