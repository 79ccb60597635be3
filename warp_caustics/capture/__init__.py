"""From a camera's frames to irradiance in the scene's window, one step per file."""
