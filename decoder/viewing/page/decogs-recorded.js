var F=Math.PI/2-.001;function w({distortionModel:i,distortion:e}){return i==="fisheye"?G(e):N(e)}function N(i){let[e,r,a,t,d,c,l,p]=Array.from({length:8},(o,m)=>i[m]??0),n=o=>{let m=1+o*(c+o*(l+o*p)),s=(1+o*(e+o*(r+o*d)))/m,f=(e+o*(2*r+3*o*d)-s*(c+o*(2*l+3*o*p)))/m;return[s,f]},u=_(o=>{let[m,s]=n(o*o);return m>0&&m+2*o*o*s>0},16);return(o,m)=>{let[s,f]=[o,m];for(let h=15;;h--){let x=s*s+f*f,[g,b]=n(x),y=s*g+2*a*s*f+t*(x+2*s*s)-o,M=f*g+a*(x+2*f*f)+2*t*s*f-m,S=Math.abs(y)+Math.abs(M);if(h===0||!(S>1e-12))return S<1e-6&&x<u*u?[s,f]:null;let A=g+2*s*s*b+2*a*f+6*t*s,C=g+2*f*f*b+6*a*f+2*t*s,v=2*s*f*b+2*a*s+2*t*f,P=A*C-v*v;s-=(C*y-v*M)/P,f-=(A*M-v*y)/P}}}function G([i,e,r,a]){let t=c=>{let l=c*c;return 1+l*(3*i+l*(5*e+l*(7*r+l*9*a)))},d=_(c=>t(c)>0,F);return(c,l)=>{let p=Math.hypot(c,l);if(p===0)return[c,l];let n=Math.min(p,d);for(let u=15;;u--){let o=n*n,m=n*(1+o*(i+o*(e+o*(r+o*a))))-p;if(u===0||!(Math.abs(m)>1e-12)){let s=Math.tan(n)/p;return Math.abs(m)<1e-6?[c*s,l*s]:null}n=Math.min(d,Math.max(0,n-m/t(n)))}}}function _(i,e){for(let r=1;r<=4096;r++){if(i(r*e/4096))continue;let[a,t]=[(r-1)*e/4096,r*e/4096];for(let d=0;d<50;d++){let c=(a+t)/2;i(c)?a=c:t=c}return a}return e}var H=2**-12,j=2**-18,I=3,D=2,U=8192;var E=-1e9;function R(i,e,r){let a=r===1?.5:0,t=h=>r===1?h:Math.ceil(h/r)+1,[d,c]=[t(i.width),t(i.height)],l=new Float32Array(2*d*c).fill(E),p=w(e),n=[new T(i.width),new T(i.height)];for(let h=0,x=0;h<c;h++){let g=(a+h*r-i.cy)/i.fy;for(let b=0;b<d;b++,x+=2){let y=p((a+b*r-i.cx)/i.fx,g);y!==null&&(l[x]=y[0]*i.fx+i.cx,l[x+1]=y[1]*i.fy+i.cy,n[0].add(l[x]),n[1].add(l[x+1]))}}let[[u,o],[m,s]]=[n[0].pixels(),n[1].pixels()];for(let h=0;h<l.length;h+=2)l[h]!==E&&(l[h]-=u,l[h+1]-=m);let f={width:o-u,height:s-m,cx:i.cx-u,cy:i.cy-m};return{camera:{...i,...f,recording:null},cell:r,first:a,columns:d,rows:c,positions:l}}var T=class{constructor(e){this.size=e}size;least=1/0;most=-1/0;add(e){e<this.least&&(this.least=e),e>this.most&&(this.most=e)}pixels(){let{size:e}=this,r=Math.max(0,Math.floor(Math.min((I-1)*e,U-e)/2)),a=Math.max(Math.floor(this.least)-D,-r),t=Math.min(Math.ceil(this.most)+D,e+r);return a<t?[a,t]:[0,e]}};var L=`#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D accumulated, positions;
uniform vec3 odds;
uniform vec4 background, place;
uniform vec2 size;
uniform float cell;
uniform bool bent;
out vec4 result;
vec4 at(ivec2 pixel) {
ivec2 all = textureSize(accumulated, 0);
pixel = clamp(pixel, ivec2(0), all - 1);
vec4 sum = texelFetch(accumulated, ivec2(pixel.x, all.y - 1 - pixel.y), 0);
return vec4(sum.rgb, 1.0 - sum.a) + sum.a * background;
}
vec4 weights(float t) {
const float A = -0.75;
vec3 d = vec3(t + 1.0, t, 1.0 - t);
float far = ((A * d.x - 5.0 * A) * d.x + 8.0 * A) * d.x - 4.0 * A;
vec2 near = ((A + 2.0) * d.yz - (A + 3.0)) * d.yz * d.yz + 1.0;
return vec4(far, near, 1.0 - far - near.x - near.y);
}
vec4 through(vec2 pixel) {
vec2 corner = floor(pixel / cell), part = pixel / cell - corner;
ivec2 first = ivec2(corner);
vec2 a = texelFetch(positions, first, 0).xy, b = texelFetch(positions, first + ivec2(1, 0), 0).xy;
vec2 c = texelFetch(positions, first + ivec2(0, 1), 0).xy, d = texelFetch(positions, first + 1, 0).xy;
vec2 from = (cell == 1.0 ? a : mix(mix(a, b, part.x), mix(c, d, part.x), part.y)) - 0.5;
if (any(lessThan(from, vec2(0.0))) || any(greaterThan(from, vec2(textureSize(accumulated, 0) - 1)))) return background;
ivec2 middle = ivec2(floor(from));
vec4 across = weights(from.x - float(middle.x)), down = weights(from.y - float(middle.y));
vec4 sum = vec4(0.0);
for (int j = 0; j < 4; ++j) for (int i = 0; i < 4; ++i) sum += across[i] * down[j] * at(middle + ivec2(i - 1, j - 1));
return sum;
}
void main() {
vec2 pixel = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
result = vec4(0.0, 0.0, 0.0, background.a);
if (any(lessThan(pixel, place.xy)) || any(greaterThan(pixel, place.zw))) return;
vec4 seen = bent ? through(pixel) : at(ivec2(pixel));
float covered = max(clamp(seen.a, 0.0, 1.0), background.a);
vec3 v = seen.rgb / max(covered, 1e-6);
vec3 inside = clamp(v, 0.0, 1.0);
vec3 recorded = min(odds * inside / (1.0 + (odds - 1.0) * inside), 1.0);
result = vec4(clamp(mix(v, recorded, equal(v, inside)), 0.0, 1.0) * covered, covered);
}
`;var z=8,O=class{constructor(e,r){this.gl=e;this.program=r(L),this.texture=e.createTexture()}gl;program;texture;plan=null;planOf="";seenBy(e,{lens:r}){if(r===null)return e;let{width:a,height:t,fx:d,fy:c,cx:l,cy:p}=e,n=JSON.stringify([a,t,d,c,l,p,r.distortionModel,r.distortion]);(this.plan===null||this.planOf!==n)&&(this.plan=R(e,r,z),this.plan.positions.includes(E)&&(this.plan=R(e,r,1)),this.planOf=n,this.upload(this.plan));let{width:u,height:o,cx:m,cy:s}=this.plan.camera;return{...e,width:u,height:o,cx:m,cy:s}}use(e,{lens:r,odds:a,left:t,top:d,width:c,height:l},p){let{gl:n,program:u}=this;n.activeTexture(n.TEXTURE1),n.bindTexture(n.TEXTURE_2D,this.texture),n.activeTexture(n.TEXTURE0),n.useProgram(u.program),n.uniform1i(u.uniform("accumulated"),0),n.uniform1i(u.uniform("positions"),1),n.uniform4fv(u.uniform("background"),p),n.uniform3fv(u.uniform("odds"),a??[1,1,1]),n.uniform4f(u.uniform("place"),t,d,t+c,d+l),n.uniform2f(u.uniform("size"),e.width,e.height),n.uniform1f(u.uniform("cell"),this.plan?.cell??1),n.uniform1i(u.uniform("bent"),r===null?0:1)}dispose(){this.gl.deleteTexture(this.texture),this.gl.deleteProgram(this.program.program)}upload({columns:e,rows:r,positions:a}){let{gl:t}=this;t.activeTexture(t.TEXTURE1),t.bindTexture(t.TEXTURE_2D,this.texture),t.texImage2D(t.TEXTURE_2D,0,t.RG32F,e,r,0,t.RG,t.FLOAT,a);for(let d of[t.TEXTURE_MIN_FILTER,t.TEXTURE_MAG_FILTER])t.texParameteri(t.TEXTURE_2D,d,t.NEAREST);t.activeTexture(t.TEXTURE0)}};export{O as RecordedPass};
