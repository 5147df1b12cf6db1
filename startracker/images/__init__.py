"""Image files: reading, raw mosaics, the stretch of pictures and the colours of stars in them."""
