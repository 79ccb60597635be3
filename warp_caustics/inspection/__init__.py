"""A printed plate against its design: deviation, regions out of tolerance, fibres, volume, verdict."""
