"""What is compiled before a run needs it: the loop, the mock, and every module type that a scene may have."""
