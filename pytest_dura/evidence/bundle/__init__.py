"""The bundle on disk: the record, what is rendered from it, and the manifest, written last."""
