//! Contains a test only: that the header of the C interface is current.
