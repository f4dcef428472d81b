"""Networks, one file each; every file can be read in one sitting."""
