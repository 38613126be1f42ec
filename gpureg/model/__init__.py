"""The variational problem (eq. 19, 20): checked, on a device, its result, what memory it takes."""
