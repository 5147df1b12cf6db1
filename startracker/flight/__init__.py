"""The tracker of one camera as C for its processor: design, integer reference, export."""
