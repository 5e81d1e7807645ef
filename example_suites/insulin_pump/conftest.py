"""Names the component under test."""

import pytest
from insulin_controller import Controller


@pytest.fixture(scope="session")
def generator():
    return Controller
