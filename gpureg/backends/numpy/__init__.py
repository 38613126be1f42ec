"""The numpy backend: the reference for the tests of the devices."""
