"""Two theses computed again, each printed value beside ours."""
