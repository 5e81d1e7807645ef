"""Views of one episode as text, table and picture, for reports of others."""
