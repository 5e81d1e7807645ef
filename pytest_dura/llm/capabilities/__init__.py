"""What a server and its model can do, found by asking them."""

from pytest_dura.llm.capabilities.found import Capabilities
from pytest_dura.llm.capabilities.probe import Probed, probe

__all__ = ["Capabilities", "Probed", "probe"]
