"""Language models as the component under test (extra ``llm``).

Every pytest run loads the options in here; the public names are imported when they are first used.
"""

from pytest_dura.public_names import imported_on_use

__getattr__, __dir__ = imported_on_use(__name__, __file__)
