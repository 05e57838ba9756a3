"""What each link is for small motions, one a file: a spring and a damper, or the statement that it is neither."""
