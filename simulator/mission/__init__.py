"""Where the spacecraft is, how it is turned, and when: clock, orbit, pointing."""
