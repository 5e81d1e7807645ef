"""Player: an episode in a browser, from above and over time, without a network.

A page takes both texts of :func:`assets` and calls, for each episode,
``DuraPlayer.mount(element, text, options)`` with the text of ``packed(player_data(trace))``, or a
function that returns it. The element then holds a button, and nothing is unpacked until it is
pressed, or at once with ``{open: true}``. ``label`` is the button's text; ``page: true`` says that
the page is this player's alone, whose keys then work wherever the focus is. ``mount`` returns
``{open(), play(), pause(), seek(tick), state}``; ``open()`` is a promise, ``state`` a copy.
"""

from pytest_dura.evidence.player.data import player_data
from pytest_dura.evidence.player.page import assets, content_hash, packed, player_page

__all__ = ["assets", "content_hash", "packed", "player_data", "player_page"]
