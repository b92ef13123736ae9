//! Comparisons with programs of others.

mod openvdb;
