"""Lines that are not straight and alike: waves along them, corners and curves."""
