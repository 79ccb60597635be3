"""What the camera did to a capture, found by comparing it with the re-simulated image."""
