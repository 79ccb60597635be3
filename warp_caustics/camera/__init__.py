"""What a camera makes of the light on the screen: a differentiable operator, noise, and frames as files hold them."""
