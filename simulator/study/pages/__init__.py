"""Pages of studies: their content as data, and the one engine that makes HTML and PDF of it."""
