"""The report of a run: content, figures, frames, page."""
