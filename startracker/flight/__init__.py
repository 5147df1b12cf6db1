"""The tracker of one camera as C for its processor: design, tables, sources, export."""
