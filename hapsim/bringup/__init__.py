"""For firmware developers: judge a device, disturb its wire, decode its frames."""
