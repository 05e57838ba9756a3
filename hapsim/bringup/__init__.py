"""Tools for firmware developers: test a device, disturb its wire, decode its frames."""
