"""What differs from place to place along a rod: soft spots, gradients, natural shapes, joints that give."""
