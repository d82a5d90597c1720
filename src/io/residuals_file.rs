//! Residuals as CSV, one line for each used observation.

use std::io::{self, Write};

use crate::model::Reprojection;

/// Writes `kind,frame,cluster,k,l,lens_type,u,v,rho,du,dv,drho`: the observed values, and observed minus projected, px. `kind`
/// is `feature` or `center`; lens types count from 1; fields that do not apply are empty.
pub fn write_residuals(out: &mut dyn Write, reprojection: &Reprojection) -> io::Result<()> {
    writeln!(out, "kind,frame,cluster,k,l,lens_type,u,v,rho,du,dv,drho")?;
    for r in &reprojection.features {
        let f = &r.feature;
        // An unused ρ is omitted.
        let rho = text(f.rho_px.filter(|_| r.drho_px.is_some()));
        let drho = text(r.drho_px);
        writeln!(
            out,
            "feature,{},{},{},{},{},{},{},{rho},{},{},{drho}",
            f.frame,
            f.corner,
            f.k,
            f.l,
            r.lens_type + 1,
            f.u_px,
            f.v_px,
            r.du_px,
            r.dv_px
        )?;
    }
    for r in &reprojection.centers {
        let c = &r.center;
        writeln!(
            out,
            "center,,,{},{},{},{},{},,{},{},",
            c.k,
            c.l,
            r.lens_type + 1,
            c.u_px,
            c.v_px,
            r.du_px,
            r.dv_px
        )?;
    }
    Ok(())
}

fn text(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}
