"""Bodies, vehicles and the landing problems made of them."""
