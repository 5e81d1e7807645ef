"""From what is perceived to the messages that a model gets: blocks, templates, pictures."""
