//! Which elementary functions give the same bits on every platform? Those of the crate `libm`, for f32 and f64.
//!
//! The standard library calls the platform's mathematical library. Its last bits depend on the version and the processor.
//! A log recorded on one machine would then not replay to the same bits on another. `clippy.toml` therefore forbids the
//! standard library's versions in `localize`, `vision` and `pipeline`. Square root and fused multiply-add are exact
//! everywhere and stay allowed, and so are rounding and the remainder.

/// f32 or f64.
pub trait Float: Copy {
    /// Sine of an angle in radians.
    fn sin(self) -> Self;
    /// Cosine of an angle in radians.
    fn cos(self) -> Self;
    /// Tangent of an angle in radians.
    fn tan(self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Inverse sine in radians.
    fn asin(self) -> Self;
    /// Inverse cosine in radians.
    fn acos(self) -> Self;
    /// Inverse tangent in radians.
    fn atan(self) -> Self;
    /// Angle of the point (x, y) in radians, with `self` = y.
    fn atan2(self, x: Self) -> Self;
    /// Hyperbolic sine.
    fn sinh(self) -> Self;
    /// Inverse hyperbolic sine.
    fn asinh(self) -> Self;
    /// Natural exponential function.
    fn exp(self) -> Self;
    /// Power of two.
    fn exp2(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// Logarithm to base 2.
    fn log2(self) -> Self;
    /// Logarithm to base 10.
    fn log10(self) -> Self;
    /// Power with a real exponent.
    fn powf(self, exponent: Self) -> Self;
    /// Length of the vector (x, y), with `self` = x. NaN if either is NaN.
    fn hypot(self, y: Self) -> Self;
}

impl Float for f32 {
    #[inline]
    fn sin(self) -> f32 {
        libm::sinf(self)
    }
    #[inline]
    fn cos(self) -> f32 {
        libm::cosf(self)
    }
    #[inline]
    fn tan(self) -> f32 {
        libm::tanf(self)
    }
    #[inline]
    fn sin_cos(self) -> (f32, f32) {
        libm::sincosf(self)
    }
    #[inline]
    fn asin(self) -> f32 {
        libm::asinf(self)
    }
    #[inline]
    fn acos(self) -> f32 {
        libm::acosf(self)
    }
    #[inline]
    fn atan(self) -> f32 {
        libm::atanf(self)
    }
    #[inline]
    fn atan2(self, x: f32) -> f32 {
        libm::atan2f(self, x)
    }
    #[inline]
    fn sinh(self) -> f32 {
        libm::sinhf(self)
    }
    #[inline]
    fn asinh(self) -> f32 {
        libm::asinhf(self)
    }
    #[inline]
    fn exp(self) -> f32 {
        libm::expf(self)
    }
    #[inline]
    fn exp2(self) -> f32 {
        libm::exp2f(self)
    }
    #[inline]
    fn ln(self) -> f32 {
        libm::logf(self)
    }
    #[inline]
    fn log2(self) -> f32 {
        libm::log2f(self)
    }
    #[inline]
    fn log10(self) -> f32 {
        libm::log10f(self)
    }
    #[inline]
    fn powf(self, exponent: f32) -> f32 {
        libm::powf(self, exponent)
    }
    /// Both squares are exact in f64 and cannot overflow. Unlike `libm::hypotf` this is inlined and vectorized.
    #[inline]
    fn hypot(self, y: f32) -> f32 {
        let (x, y) = (f64::from(self), f64::from(y));
        (x * x + y * y).sqrt() as f32
    }
}

impl Float for f64 {
    #[inline]
    fn sin(self) -> f64 {
        libm::sin(self)
    }
    #[inline]
    fn cos(self) -> f64 {
        libm::cos(self)
    }
    #[inline]
    fn tan(self) -> f64 {
        libm::tan(self)
    }
    #[inline]
    fn sin_cos(self) -> (f64, f64) {
        libm::sincos(self)
    }
    #[inline]
    fn asin(self) -> f64 {
        libm::asin(self)
    }
    #[inline]
    fn acos(self) -> f64 {
        libm::acos(self)
    }
    #[inline]
    fn atan(self) -> f64 {
        libm::atan(self)
    }
    #[inline]
    fn atan2(self, x: f64) -> f64 {
        libm::atan2(self, x)
    }
    #[inline]
    fn sinh(self) -> f64 {
        libm::sinh(self)
    }
    #[inline]
    fn asinh(self) -> f64 {
        libm::asinh(self)
    }
    #[inline]
    fn exp(self) -> f64 {
        libm::exp(self)
    }
    #[inline]
    fn exp2(self) -> f64 {
        libm::exp2(self)
    }
    #[inline]
    fn ln(self) -> f64 {
        libm::log(self)
    }
    #[inline]
    fn log2(self) -> f64 {
        libm::log2(self)
    }
    #[inline]
    fn log10(self) -> f64 {
        libm::log10(self)
    }
    #[inline]
    fn powf(self, exponent: f64) -> f64 {
        libm::pow(self, exponent)
    }
    #[inline]
    fn hypot(self, y: f64) -> f64 {
        libm::hypot(self, y)
    }
}

/// Sine of an angle in radians.
#[inline]
pub fn sin<T: Float>(angle: T) -> T {
    angle.sin()
}

/// Cosine of an angle in radians.
#[inline]
pub fn cos<T: Float>(angle: T) -> T {
    angle.cos()
}

/// Tangent of an angle in radians.
#[inline]
pub fn tan<T: Float>(angle: T) -> T {
    angle.tan()
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos<T: Float>(angle: T) -> (T, T) {
    angle.sin_cos()
}

/// Inverse sine in radians.
#[inline]
pub fn asin<T: Float>(x: T) -> T {
    x.asin()
}

/// Inverse cosine in radians.
#[inline]
pub fn acos<T: Float>(x: T) -> T {
    x.acos()
}

/// Inverse tangent in radians.
#[inline]
pub fn atan<T: Float>(x: T) -> T {
    x.atan()
}

/// Angle of the point (x, y) in radians.
#[inline]
pub fn atan2<T: Float>(y: T, x: T) -> T {
    y.atan2(x)
}

/// Hyperbolic sine.
#[inline]
pub fn sinh<T: Float>(x: T) -> T {
    x.sinh()
}

/// Inverse hyperbolic sine.
#[inline]
pub fn asinh<T: Float>(x: T) -> T {
    x.asinh()
}

/// Natural exponential function.
#[inline]
pub fn exp<T: Float>(x: T) -> T {
    x.exp()
}

/// Power of two.
#[inline]
pub fn exp2<T: Float>(x: T) -> T {
    x.exp2()
}

/// Natural logarithm.
#[inline]
pub fn ln<T: Float>(x: T) -> T {
    x.ln()
}

/// Logarithm to base 2.
#[inline]
pub fn log2<T: Float>(x: T) -> T {
    x.log2()
}

/// Logarithm to base 10.
#[inline]
pub fn log10<T: Float>(x: T) -> T {
    x.log10()
}

/// Power with a real exponent.
#[inline]
pub fn powf<T: Float>(base: T, exponent: T) -> T {
    base.powf(exponent)
}

/// Length of the vector (x, y). NaN if either is NaN.
#[inline]
pub fn hypot<T: Float>(x: T, y: T) -> T {
    x.hypot(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// FNV-1a over the bits of all functions at the same arguments.
    fn digest() -> u64 {
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let mut add = |bits: u64| {
            for byte in bits.to_le_bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        for k in 0..4000 {
            // Irregular arguments from 0.001 to 900, both signs.
            let size = f64::from(k % 1000 + 1) * 0.897_123 + 1e-3 * f64::from(k);
            let x = if k % 2 == 0 { size } else { -size };
            let small = x / (1.0 + size);
            for value in [sin(x), cos(x), tan(x), asin(small), acos(small), atan(x)] {
                add(value.to_bits());
            }
            for value in [
                atan2(x, 3.0),
                sinh(small),
                exp(x / 3.0),
                exp2(small),
                ln(size),
            ] {
                add(value.to_bits());
            }
            for value in [log2(size), log10(size), powf(size, small), hypot(x, small)] {
                add(value.to_bits());
            }
            assert_eq!(sin_cos(x), (sin(x), cos(x)), "{x}");
            let (x, size, small) = (x as f32, size as f32, small as f32);
            for value in [sin(x), cos(x), tan(x), asin(small), acos(small), atan(x)] {
                add(u64::from(value.to_bits()));
            }
            for value in [
                atan2(x, 3.0),
                sinh(small),
                exp(x / 30.0),
                exp2(small),
                ln(size),
            ] {
                add(u64::from(value.to_bits()));
            }
            for value in [log2(size), log10(size), powf(size, small), hypot(x, small)] {
                add(u64::from(value.to_bits()));
            }
            assert_eq!(sin_cos(x), (sin(x), cos(x)), "{x}");
        }
        hash
    }

    /// A new version of the crate `libm` may change bits. Then logs of earlier versions no longer verify.
    #[test]
    fn bits_are_those_of_this_version_s_logs() {
        assert_eq!(digest(), 1_460_490_451_676_226_758);
    }

    /// The platform's library is the reference here, with a tolerance.
    #[test]
    fn values_agree_with_the_platform_s_within_two_units_in_the_last_place() {
        let near = |ours: f32, exact: f64, what: &str, x: f32| {
            let unit =
                f64::from((exact as f32).abs().max(f32::MIN_POSITIVE)) * f64::from(f32::EPSILON);
            assert!(
                (f64::from(ours) - exact).abs() <= unit,
                "{what}({x}) = {ours}, exact {exact}"
            );
        };
        for k in -3000..3000_i16 {
            let x = f32::from(k) * 0.0171;
            let wide = f64::from(x);
            near(sin(x), wide.sin(), "sin", x);
            near(cos(x), wide.cos(), "cos", x);
            near(tan(x), wide.tan(), "tan", x);
            near(atan(x), wide.atan(), "atan", x);
            near(exp(x), wide.exp(), "exp", x);
            near(exp2(x), wide.exp2(), "exp2", x);
            near(sinh(x), wide.sinh(), "sinh", x);
            near(asinh(x), wide.asinh(), "asinh", x);
            near(atan2(x, -0.7), wide.atan2(f64::from(-0.7_f32)), "atan2", x);
            near(hypot(x, 0.3), wide.hypot(f64::from(0.3_f32)), "hypot", x);
            let positive = x.abs() + 0.01;
            near(ln(positive), f64::from(positive).ln(), "ln", positive);
            near(log2(positive), f64::from(positive).log2(), "log2", positive);
            near(
                log10(positive),
                f64::from(positive).log10(),
                "log10",
                positive,
            );
            near(
                powf(positive, 0.45),
                f64::from(positive).powf(f64::from(0.45_f32)),
                "powf",
                positive,
            );
            let share = x / 52.0;
            near(asin(share), f64::from(share).asin(), "asin", share);
            near(acos(share), f64::from(share).acos(), "acos", share);
        }
    }
}
